// How a viewer is operated: the line between both sides, keys, and its controls.
"use strict";
const Operating = (() => {
  const STEP = 2, TURN = Math.PI / 24;

  class Operating {
    constructor(viewer) {
      this.viewer = viewer;
    }

    listen() {
      const line = this.viewer.line, names = ["lit", "wires", "charts", "seams", "texels", "flat"];
      line.addEventListener("pointerdown", (event) => { line.setPointerCapture(event.pointerId); line.focus(); event.preventDefault(); });
      line.addEventListener("pointermove", (event) => {
        if (!line.hasPointerCapture(event.pointerId)) return;
        const box = this.viewer.place.getBoundingClientRect();
        this.swipe((100 * (event.clientX - box.left)) / box.width);
      });
      line.addEventListener("keydown", (event) => this.swipeByKey(event));
      for (const name of names) Viewer.found(this.viewer.root, name)?.addEventListener("change", () => this.viewer.look());
      Viewer.found(this.viewer.root, "reset")?.addEventListener("click", () => this.viewer.reset());
      for (const radio of this.viewer.root.querySelectorAll("input[data-show]"))
        radio.addEventListener("change", () => this.present(radio.dataset.show));
      const reach = Viewer.found(this.viewer.root, "reach"), layers = Viewer.found(this.viewer.root, "layer");
      reach.value = this.viewer.data.reach;
      reach.addEventListener("input", () => this.limit(Number(reach.value)));
      layers.replaceChildren(...this.viewer.layers.map(({ name }, number) => new Option(name, number)));
      layers.parentElement.hidden = this.viewer.layers.length < 2;
      layers.addEventListener("change", () => this.viewer.choose(Number(layers.value)));
      this.viewer.canvas.tabIndex = 0;
      this.viewer.canvas.setAttribute("role", "img");
      this.viewer.canvas.setAttribute("aria-label", "The model, before to the left of the line and after to its right. Arrow keys turn it, + and - zoom.");
      this.viewer.canvas.addEventListener("keydown", (event) => this.turnByKey(event));
      document.addEventListener("keydown", (event) => this.switchByKey(event));
      this.drawScale();
      this.limit(this.viewer.data.reach);
      this.swipe(50);
    }

    drawScale() {
      const stops = this.viewer.data.scale.map((colour) => `rgb(${colour.map((value) => Math.round(255 * value)).join(" ")})`);
      Viewer.found(this.viewer.root, "gradient").style.background = `linear-gradient(to right, ${stops.join(", ")})`;
    }

    limit(reach) {
      this.viewer.shared.reach.value = reach;
      Viewer.found(this.viewer.root, "limit").textContent = `${reach}/255 or more`;
      this.viewer.draw();
    }

    swipe(at) {
      this.viewer.at = Math.min(100, Math.max(0, at));
      this.viewer.line.style.left = `${this.viewer.at}%`;
      this.viewer.line.setAttribute("aria-valuenow", Math.round(this.viewer.at));
      this.viewer.line.setAttribute("aria-valuetext", `${Math.round(this.viewer.at)} % before, ${100 - Math.round(this.viewer.at)} % after`);
      this.viewer.draw();
    }

    swipeByKey(event) {
      const steps = { ArrowLeft: -STEP, ArrowDown: -STEP, ArrowRight: STEP, ArrowUp: STEP, PageDown: -10, PageUp: 10, Home: -100, End: 100 };
      if (!(event.key in steps)) return;
      event.preventDefault();
      this.swipe(this.viewer.at + steps[event.key]);
    }

    turnByKey(event) {
      const turns = { ArrowLeft: [-TURN, 0], ArrowRight: [TURN, 0], ArrowUp: [0, -TURN], ArrowDown: [0, TURN] };
      const zooms = { "+": 1 / 1.2, "=": 1 / 1.2, "-": 1.2 };
      if (event.key === "0") this.viewer.reset();
      if (!(event.key in turns) && !(event.key in zooms)) return;
      event.preventDefault();
      const offset = this.viewer.camera.position.clone().sub(this.viewer.controls.target), place = new THREE.Spherical().setFromVector3(offset);
      const [right, down] = turns[event.key] || [0, 0];
      if (this.viewer.isFlat) {
        const step = new THREE.Vector3(right, -down, 0).multiplyScalar(0.5 * place.radius);
        this.viewer.camera.position.add(step);
        this.viewer.controls.target.add(step);
      } else {
        place.theta += right;
        place.phi += down;
        place.makeSafe();
      }
      place.radius *= zooms[event.key] || 1;
      this.viewer.camera.position.copy(this.viewer.controls.target).add(new THREE.Vector3().setFromSpherical(place));
      this.viewer.controls.update();
      this.viewer.draw();
    }

    // B goes from before to after and back, from wherever the focus is unless keys mean something there.
    switchByKey(event) {
      const busy = event.target.closest?.("input[type=text], select, textarea");
      if (busy || event.ctrlKey || event.metaKey || event.altKey) return;
      const wanted = { b: this.viewer.show === "after" ? "before" : "after", d: "difference", s: "swipe" }[event.key.toLowerCase()];
      if (wanted) this.present(wanted);
    }

    present(show) {
      this.viewer.show = show;
      this.viewer.place.dataset.show = show;
      for (const radio of this.viewer.root.querySelectorAll("input[data-show]")) radio.checked = radio.dataset.show === show;
      Viewer.found(this.viewer.root, "legend").hidden = show !== "difference";
      this.viewer.draw();
    }
  }

  return Operating;
})();
