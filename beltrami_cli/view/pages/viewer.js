// Draws the colours before and after, under one camera, with a line between them: in the report and the live view.
"use strict";
const Viewer = (() => {
  const FIELD = 30, DISTANCE = 2.4;
  const SIDES = { before: 0, after: 1, difference: 2 };

  const loaded = (source) => new Promise((resolve, reject) => new THREE.TextureLoader().load(source, resolve, undefined, reject));

  // Parts of a page by their data-viewer; missing ones are left alone.
  const found = (root, name) => root.querySelector(`[data-viewer=${name}]`);

  class Viewer {
    constructor(root, file) {
      this.root = root;
      this.file = file; // binary glTF
      this.place = found(root, "place");
      this.line = found(root, "line");
      this.at = 50;
      this.show = "swipe";
      this.operating = new Operating(this);
      this.updating = new Updating(this);
    }

    async start() {
      const { parser, scenes, userData } = await new THREE.GLTFLoader().parseAsync(this.file, "");
      this.data = userData;
      this.maps = await parser.getDependencies("texture");
      for (const map of this.maps) map.colorSpace = THREE.SRGBColorSpace;
      try {
        this.renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true, preserveDrawingBuffer: true });
      } catch (error) {
        return this.withoutDrawing();
      }
      this.shared = {
        side: { value: 0 }, reach: { value: userData.reach }, lit: { value: 0 }, charts: { value: 0 }, high: { value: 1 },
        scale: { value: userData.scale.map((colour) => new THREE.Vector3(...colour)) },
      };
      this.renderer.setPixelRatio(window.devicePixelRatio);
      this.renderer.setScissorTest(true);
      this.canvas = this.renderer.domElement;
      this.place.prepend(this.canvas);
      const shapes = new Shapes(this.maps, this.shared);
      this.layers = scenes.map((scene) => shapes.layerOf(scene));
      this.camera = new THREE.PerspectiveCamera(FIELD, 1, 0.01, 100);
      this.controls = new THREE.OrbitControls(this.camera, this.canvas);
      this.controls.zoomToCursor = true;
      this.controls.minDistance = 1e-3;
      this.controls.addEventListener("change", () => this.draw());
      new ResizeObserver(() => this.resize()).observe(this.place);
      this.operating.listen();
      this.choose(0);
      this.resize();
      this.place.dataset.ready = "yes";
      return this;
    }

    // Without WebGL: the pictures as they are.
    withoutDrawing() {
      const said = document.createElement("p");
      said.textContent = "This browser has no WebGL, which the view of the models needs. The pictures alone:";
      const pictures = this.maps.map(({ image }) => {
        const canvas = Object.assign(document.createElement("canvas"), { width: image.width, height: image.height });
        canvas.getContext("2d").drawImage(image, 0, 0);
        return canvas;
      });
      this.place.replaceChildren(said, ...pictures);
      this.place.dataset.ready = "no";
      return this;
    }

    // Shows another layer: the textures of a slot, or the vertex colours.
    choose(number) {
      this.number = number;
      this.layer = this.layers[number];
      this.isFlat = Boolean(this.layer.flatOnly);
      for (const name of ["charts", "seams"]) this.offer(name, this.layer.seams.length > 0);
      this.offer("flat", this.layer.flat.children.length > 0 && !this.layer.flatOnly);
      this.offer("wires", this.layer.wires.length > 0);
      this.offer("lit", this.layer.wires.length > 0);
      this.offer("texels", this.layer.flat.children.length > 0);
      for (const group of this.root.querySelectorAll("fieldset"))
        group.hidden = [...group.querySelectorAll("label")].every((label) => label.hidden);
      this.look();
      this.reset();
      this.root.dispatchEvent(new Event("layer"));
    }

    offer(name, is_there) {
      const box = found(this.root, name);
      if (!box) return;
      box.parentElement.hidden = !is_there;
      if (!is_there) box.checked = false;
    }

    look() {
      const on = (name) => Boolean(found(this.root, name)?.checked);
      const flat = Boolean(this.layer.flatOnly) || on("flat");
      if (flat !== this.isFlat) { this.isFlat = flat; this.reset(); }
      this.shared.lit.value = on("lit") && !flat ? 1 : 0;
      this.shared.charts.value = on("charts") ? 1 : 0;
      for (const lines of this.layer.wires) lines.visible = on("wires");
      for (const lines of this.layer.seams) lines.visible = on("seams");
      for (const tint of this.layer.tints || []) tint.visible = on("charts");
      this.filter = on("texels") ? THREE.NearestFilter : THREE.LinearFilter;
      for (const layer of this.layers)
        for (const { uniforms } of layer.materials) for (const map of [uniforms.mapOld, uniforms.mapFresh]) this.refilter(map.value);
      this.draw();
    }

    refilter(map) {
      if (!map || map.magFilter === this.filter) return;
      map.magFilter = this.filter;
      map.needsUpdate = true;
    }

    // The centre of the view: origin and direction of a ray through the box of the model, or u, v and number of a texture.
    focus() {
      const target = this.controls.target, { flat, middle } = this.layer;
      if (!this.isFlat) {
        const from = this.camera.position, way = target.clone().sub(from).normalize();
        return [from.x + middle[0], from.y + middle[1], from.z + middle[2], way.x, way.y, way.z];
      }
      const x = target.x / flat.scale.x, y = target.y / flat.scale.y;
      const gaps = flat.children.map((sheet) => Math.max(0, Math.abs(x - sheet.position.x) - sheet.scale.x / 2));
      const number = gaps.indexOf(Math.min(...gaps)), sheet = flat.children[number];
      return [(x - sheet.position.x) / sheet.scale.x + 0.5, 0.5 - y, sheet.userData.number];
    }

    reset() {
      const flat = this.isFlat, far = flat ? DISTANCE / 1.15 : DISTANCE;
      this.controls.enableRotate = !flat;
      this.controls.mouseButtons.LEFT = flat ? THREE.MOUSE.PAN : THREE.MOUSE.ROTATE;
      this.controls.touches.ONE = flat ? THREE.TOUCH.PAN : THREE.TOUCH.ROTATE;
      this.controls.target.set(0, 0, 0);
      this.camera.position.set(0, 0, far * Math.max(1, 1 / this.camera.aspect));
      this.controls.update();
      this.draw();
    }

    resize() {
      const { clientWidth: width, clientHeight: height } = this.place;
      if (!width || !height) return;
      const before = Math.max(1, 1 / this.camera.aspect);
      this.renderer.setSize(width, height);
      this.shared.high.value = height * window.devicePixelRatio;
      this.camera.aspect = width / height;
      // The whole model stays in view on narrow screens.
      this.camera.position.sub(this.controls.target).multiplyScalar(Math.max(1, height / width) / before).add(this.controls.target);
      this.controls.update();
      this.draw();
    }

    draw() {
      if (this.isDrawing || !this.layer) return;
      this.isDrawing = true;
      requestAnimationFrame(() => {
        this.isDrawing = false;
        const far = this.camera.position.distanceTo(this.controls.target);
        [this.camera.near, this.camera.far] = [Math.max(1e-5, far / 100), far + 20];
        this.camera.updateProjectionMatrix();
        const scene = this.isFlat ? this.layer.flat : this.layer.solid, { clientWidth: width } = this.place;
        const at = (width * this.at) / 100;
        if (!this.place.dataset.stage) this.chooseStage(scene, width);
        if (this.show !== "swipe") return this.pass(scene, this.show, 0, width);
        this.pass(scene, "before", 0, at);
        this.pass(scene, "after", at, width - at);
      });
    }

    // Grey where more than a quarter of the model is twice as close to the colour of the plain stage as to grey.
    chooseStage(scene, width) {
      this.pass(scene, "before", 0, width);
      const small = Object.assign(document.createElement("canvas"), { width: 64, height: 64 }).getContext("2d");
      small.drawImage(this.canvas, 0, 0, 64, 64);
      const stage = getComputedStyle(this.place).backgroundColor.match(/[\d.]+/g).slice(0, 3).map(Number);
      const { data } = small.getImageData(0, 0, 64, 64);
      let seen = 0, lost = 0;
      for (let at = 0; at < data.length; at += 4) {
        const far = (colour) => Math.max(...colour.map((value, channel) => Math.abs(data[at + channel] - value)));
        if (data[at + 3] < 128) continue;
        seen += 1;
        if (2 * far(stage) < far([128, 128, 128])) lost += 1;
      }
      this.place.dataset.stage = lost > 0.25 * seen ? "grey" : "plain";
    }

    pass(scene, side, left, width) {
      if (width <= 0) return;
      this.shared.side.value = SIDES[side];
      this.renderer.setScissor(left, 0, width, this.place.clientHeight);
      this.renderer.render(scene, this.camera);
    }
  }

  const data = (name) => JSON.parse(document.getElementById(name).textContent);

  // The viewer of a page, whose library is packed, and drawn is what `file` gives.
  async function opened(file) {
    const library = document.createElement("script");
    library.textContent = new TextDecoder().decode(await Unpacking.inflated(data("three")));
    document.head.append(library); // the policy of the page allows this text
    return new Viewer(document.getElementById("viewer"), await file()).start();
  }

  return Object.assign(Viewer, { data, found, loaded, opened });
})();
