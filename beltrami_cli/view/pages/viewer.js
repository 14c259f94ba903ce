// Draws what was painted before and after, under one camera, with a line between them: in the report and the live view.
"use strict";
const Viewer = (() => {
  const FIELD = 30, DISTANCE = 2.4, STEP = 2, TURN = Math.PI / 24;
  const WRAPS = { repeat: THREE.RepeatWrapping, mirror: THREE.MirroredRepeatWrapping, clamp: THREE.ClampToEdgeWrapping };
  const SIDES = { before: 0, after: 1, difference: 2 };

  const VERTEX = `
    attribute vec3 moved, before, after;
    attribute float chart;
    uniform int side;
    uniform float disc, moves, high;
    varying vec2 place;
    varying vec3 old, fresh, seen;
    flat varying float number;
    vec3 light(vec3 c) { return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(0.04045, c)); }
    void main() {
      place = uv; old = light(before); fresh = light(after); number = chart;
      vec4 from = modelViewMatrix * vec4(side == 0 || moves == 0.0 ? position : moved, 1.0);
      seen = from.xyz;
      gl_Position = projectionMatrix * from;
      gl_PointSize = max(1.5, disc * high * projectionMatrix[1][1] / 2.0 / -from.z);
    }`;
  const FRAGMENT = `
    uniform sampler2D mapOld, mapFresh;
    uniform int side;
    uniform float reach, lit, charts, hides, textured, plain, discs;
    uniform vec3 scale[11];
    varying vec2 place;
    varying vec3 old, fresh, seen;
    flat varying float number;
    vec3 shown(vec3 c) { return mix(12.92 * c, 1.055 * pow(max(c, 0.0031308), vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c)); }
    vec3 hue(float turn) { return clamp(abs(fract(turn + vec3(0.0, 2.0, 1.0) / 3.0) * 6.0 - 3.0) - 1.0, 0.0, 1.0); }
    void main() {
      if (discs > 0.5 && length(gl_PointCoord - 0.5) > 0.5) discard;
      vec4 one = textured > 0.5 ? texture2D(mapOld, place) : vec4(old, 1.0);
      vec4 two = textured > 0.5 ? texture2D(mapFresh, place) : vec4(fresh, 1.0);
      if (plain > 0.5) one = two = vec4(vec3(0.32), 1.0);
      if (hides > 0.5 && (side == 0 ? one.a : two.a) < 0.5) discard;
      vec3 colour = side == 0 ? one.rgb : two.rgb;
      if (charts > 0.5) colour = mix(colour, hue(number * 0.618034), 0.6);
      if (lit > 0.5) {
        vec3 across = cross(dFdx(seen), dFdy(seen));
        float lamp = dot(normalize(across), vec3(-0.4, 0.5, 0.77));
        colour *= 0.35 + 0.65 * max(0.0, lamp);
      }
      colour = shown(colour);
      if (side == 2) {
        vec3 change = abs(shown(two.rgb) - shown(one.rgb));
        float at = 10.0 * clamp(255.0 * max(change.r, max(change.g, change.b)) / reach, 0.0, 1.0);
        int below = min(9, int(at));
        colour = mix(scale[below], scale[below + 1], at - float(below));
      }
      gl_FragColor = vec4(colour, 1.0);
    }`;

  async function inflated(text) {
    const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Response(stream).arrayBuffer();
  }

  // Rows of which the differences to the rows before are given, column by column.
  function summed(steps, columns) {
    const rows = new steps.constructor(steps.length), count = steps.length / columns;
    for (let column = 0; column < columns; column++) {
      for (let row = 0, at = column; row < count; row++, at += columns)
        rows[at] = steps[column * count + row] + (row ? rows[at - columns] : 0);
    }
    return rows;
  }

  const loaded = (source) => new Promise((resolve, reject) => new THREE.TextureLoader().load(source, resolve, undefined, reject));

  function textureOf(image, wrap) {
    const made = new THREE.Texture(image);
    made.flipY = false; // v points down here
    made.colorSpace = THREE.SRGBColorSpace;
    [made.wrapS, made.wrapT] = wrap.map((mode) => WRAPS[mode]);
    made.needsUpdate = true;
    return made;
  }

  // Parts of a page by their data-viewer; those that it lacks are left alone.
  const found = (root, name) => root.querySelector(`[data-viewer=${name}]`);

  class Viewer {
    constructor(root, data) {
      this.root = root;
      this.data = data;
      this.place = found(root, "place");
      this.line = found(root, "line");
      this.at = 50;
      this.show = "swipe";
      this.shared = {
        side: { value: 0 }, reach: { value: data.reach }, lit: { value: 0 }, charts: { value: 0 }, high: { value: 1 },
        scale: { value: data.scale.map((colour) => new THREE.Vector3(...colour)) },
      };
    }

    async start() {
      try {
        this.renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true, preserveDrawingBuffer: true });
      } catch (error) {
        return this.withoutDrawing();
      }
      this.renderer.setPixelRatio(window.devicePixelRatio);
      this.renderer.setScissorTest(true);
      this.canvas = this.renderer.domElement;
      this.place.prepend(this.canvas);
      const { buffers, textures } = this.data;
      this.arrays = {};
      await Promise.all(Object.keys(buffers).map(async (key) => { this.arrays[key] = await inflated(buffers[key]); }));
      this.images = await Promise.all(textures.map(async ({ source }) => (await loaded(source)).image));
      this.maps = textures.map(({ wrap }, number) => textureOf(this.images[number], wrap));
      this.layers = this.data.layers.map((layer) => this.layerOf(layer));
      this.camera = new THREE.PerspectiveCamera(FIELD, 1, 0.01, 100);
      this.controls = new THREE.OrbitControls(this.camera, this.canvas);
      this.controls.zoomToCursor = true;
      this.controls.minDistance = 1e-3;
      this.controls.addEventListener("change", () => this.draw());
      new ResizeObserver(() => this.resize()).observe(this.place);
      this.listen();
      this.choose(0);
      this.resize();
      this.place.dataset.ready = "yes";
      return this;
    }

    // Without WebGL: the pictures as they are.
    withoutDrawing() {
      const said = document.createElement("p");
      said.textContent = "This browser has no WebGL, which the view of the models needs. The pictures alone:";
      const pictures = this.data.textures.map(({ source }) => Object.assign(new Image(), { src: source, alt: "a texture" }));
      this.place.replaceChildren(said, ...pictures);
      this.place.dataset.ready = "no";
      return this;
    }

    layerOf(layer) {
      const solid = new THREE.Group(), flat = new THREE.Group();
      solid.position.set(...layer.middle.map((value) => -value));
      const made = { ...layer, solid, flat, materials: [], textured: [], meshes: [], wires: [], seams: [] };
      for (const part of layer.parts) if (part.kind !== "sheet") this.addPart(made, part);
      if (layer.seams) made.seams.push(this.lines(this.positions(layer.seams), 0xd55e00, solid));
      this.addSheets(made);
      return made;
    }

    positions(key) {
      return new THREE.BufferAttribute(summed(new Uint16Array(this.arrays[key]), 3), 3, true);
    }

    addPart(layer, part) {
      const geometry = new THREE.BufferGeometry(), arrays = this.arrays;
      geometry.setAttribute("position", this.positions(part.position));
      if (part.moved) geometry.setAttribute("moved", this.positions(part.moved));
      if (part.colours)
        ["before", "after"].forEach((name, side) =>
          geometry.setAttribute(name, new THREE.BufferAttribute(new Uint16Array(arrays[part.colours[side]]).slice(), 3, true)));
      if (part.uv) geometry.setAttribute("uv", new THREE.BufferAttribute(new Float32Array(arrays[part.uv]), 2));
      if (part.charts) geometry.setAttribute("chart", new THREE.BufferAttribute(new Uint16Array(arrays[part.charts]), 1));
      if (part.index) geometry.setIndex(new THREE.BufferAttribute(summed(new Uint32Array(arrays[part.index]), 3), 1));
      const material = this.material(part);
      const shape = part.kind === "points" ? new THREE.Points(geometry, material) : new THREE.Mesh(geometry, material);
      shape.frustumCulled = false;
      layer.materials.push(material);
      layer.textured.push([part, material]);
      layer.meshes.push(shape);
      layer.solid.add(shape);
      if (part.index) layer.wires.push(this.wires(geometry, layer.solid));
    }

    material(part) {
      const [old, fresh] = (part.textures || [null, null]).map((number) => (number === null ? null : this.maps[number]));
      const hides = old && this.data.textures[part.textures[0]].hides;
      const own = {
        disc: part.size || 0, moves: part.moved ? 1 : 0, hides: hides ? 1 : 0, textured: old ? 1 : 0,
        plain: old || part.colours ? 0 : 1, discs: part.kind === "points" ? 1 : 0, mapOld: old, mapFresh: fresh,
      };
      const uniforms = Object.fromEntries(Object.entries(own).map(([name, value]) => [name, { value }]));
      return new THREE.ShaderMaterial({
        uniforms: { ...uniforms, ...this.shared }, vertexShader: VERTEX, fragmentShader: FRAGMENT, side: THREE.DoubleSide,
        polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1,
      });
    }

    wires(geometry, group) {
      const faces = geometry.index.array, ends = new Uint32Array(2 * faces.length);
      for (let at = 0; at < faces.length; at += 3)
        ends.set([faces[at], faces[at + 1], faces[at + 1], faces[at + 2], faces[at + 2], faces[at]], 2 * at);
      return this.lines(geometry.attributes.position, 0x808080, group, ends);
    }

    lines(positions, colour, group, ends) {
      const geometry = new THREE.BufferGeometry();
      geometry.setAttribute("position", positions);
      if (ends) geometry.setIndex(new THREE.BufferAttribute(ends, 1));
      const drawn = new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ color: colour }));
      drawn.frustumCulled = drawn.visible = false;
      group.add(drawn);
      return drawn;
    }

    // Textures as they are stored, side by side, under the triangles in their coordinates.
    addSheets(layer) {
      const pairs = [...new Map(layer.parts.filter((part) => part.textures).map((part) => [part.textures[0], part])).values()];
      const sizes = pairs.map((part) => this.images[part.textures[0]]).map((image) => image.width / image.height);
      const total = sizes.reduce((sum, size) => sum + size, 0) + 0.05 * (pairs.length - 1);
      let left = -total / 2;
      pairs.forEach((part, number) => {
        const sheet = new THREE.Group();
        sheet.userData.number = layer.numbers ? layer.numbers.indexOf(part.textures[0]) : 0;
        const plane = new THREE.PlaneGeometry(1, 1);
        plane.attributes.uv.array.set([0, 0, 1, 0, 0, 1, 1, 1]);
        const material = this.material({ ...part, moved: null });
        material.uniforms.hides.value = 0;
        material.uniforms.charts = { value: 0 };
        layer.materials.push(material);
        layer.textured.push([part, material]);
        sheet.add(new THREE.Mesh(plane, material));
        sheet.scale.set(sizes[number], 1, 1);
        sheet.position.x = left + sizes[number] / 2;
        layer.parts.forEach((other, at) => { if (other.textures && other.textures[0] === part.textures[0]) this.addFlat(layer, at, sheet); });
        layer.flat.add(sheet);
        left += sizes[number] + 0.05;
      });
      layer.flat.scale.setScalar(1 / Math.max(1, total));
    }

    addFlat(layer, number, sheet) {
      const part = layer.parts[number], mesh = layer.meshes[number];
      if (layer.flatOnly) return;
      const uv = mesh.geometry.attributes.uv, places = new Float32Array(3 * uv.count);
      for (let at = 0; at < uv.count; at++) places.set([uv.getX(at) - 0.5, 0.5 - uv.getY(at), 0.001], 3 * at);
      const geometry = new THREE.BufferGeometry(), flat = new THREE.BufferAttribute(places, 3);
      for (const name of ["uv", "chart"]) if (mesh.geometry.attributes[name]) geometry.setAttribute(name, mesh.geometry.attributes[name]);
      geometry.setAttribute("position", flat);
      geometry.setIndex(mesh.geometry.index);
      const tinted = new THREE.Mesh(geometry, mesh.material);
      tinted.visible = false;
      layer.tints = [...(layer.tints || []), tinted];
      sheet.add(tinted);
      layer.wires.push(this.wires(geometry, sheet));
      if (!part.borders) return;
      const borders = new Float32Array(this.arrays[part.borders]), ends = new Float32Array((3 * borders.length) / 2);
      for (let at = 0; at < borders.length / 2; at++)
        ends.set([borders[2 * at] - 0.5, 0.5 - borders[2 * at + 1], 0.002], 3 * at);
      layer.seams.push(this.lines(new THREE.BufferAttribute(ends, 3), 0xd55e00, sheet));
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

    // Where somebody looks: a ray through the box of the model, or a place of a flat texture.
    focus() {
      const target = this.controls.target, { flat, middle } = this.layer;
      if (!this.isFlat) {
        const from = this.camera.position, way = target.clone().sub(from).normalize();
        return { origin: [from.x + middle[0], from.y + middle[1], from.z + middle[2]], direction: [way.x, way.y, way.z] };
      }
      const x = target.x / flat.scale.x, y = target.y / flat.scale.y;
      const beside = flat.children.map((sheet) => Math.max(0, Math.abs(x - sheet.position.x) - sheet.scale.x / 2));
      const number = beside.indexOf(Math.min(...beside)), sheet = flat.children[number];
      return { origin: [(x - sheet.position.x) / sheet.scale.x + 0.5, 0.5 - y, sheet.userData.number], direction: null };
    }

    // Shows new colours: of all or some vertices, of a texture, or of a part of one.
    async paint(patches) {
      for (const patch of patches) {
        const layer = this.layers[patch.layer];
        if (patch.colours) await this.paintVertices(layer, patch);
        else if (patch.source) await this.paintTexture(layer, patch);
        else await this.paintTexels(layer, patch);
      }
      this.draw();
    }

    async paintVertices(layer, patch) {
      const rows = new Uint32Array(await inflated(patch.rows)), colours = new Uint16Array(await inflated(patch.colours));
      const { after } = layer.meshes[0].geometry.attributes;
      for (let at = 0; at < rows.length; at++)
        for (let channel = 0; channel < 3; channel++) after.array[3 * rows[at] + channel] = colours[3 * at + channel];
      after.needsUpdate = true;
    }

    // The parts with a texture, by its number in the layer.
    using(layer, number) {
      const first = layer.numbers[number];
      return layer.textured.filter(([part]) => part.textures && part.textures[0] === first);
    }

    async paintTexture(layer, patch) {
      const { image } = await loaded(patch.source), parts = this.using(layer, patch.texture);
      if (parts.length) this.replace(parts, image);
    }

    replace(parts, image) {
      const { uniforms } = parts[0][1], old = uniforms.mapFresh.value;
      const made = textureOf(image, this.data.textures[parts[0][0].textures[0]].wrap);
      this.refilter(made);
      for (const [, material] of parts) material.uniforms.mapFresh.value = made;
      if (old !== uniforms.mapOld.value) old.dispose();
      return made;
    }

    async paintTexels(layer, patch) {
      const parts = this.using(layer, patch.texture), { uniforms } = parts[0][1];
      let map = uniforms.mapFresh.value;
      if (map === uniforms.mapOld.value) map = this.replace(parts, map.image);
      const pixels = new Uint8Array(await inflated(patch.pixels));
      const piece = new THREE.DataTexture(pixels, patch.width, patch.height);
      piece.colorSpace = THREE.SRGBColorSpace;
      piece.needsUpdate = true;
      this.renderer.initTexture(map);
      this.renderer.copyTextureToTexture(piece, map, null, new THREE.Vector2(patch.x, patch.y));
      piece.dispose();
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
        if (this.show !== "swipe") return this.pass(scene, this.show, 0, width);
        this.pass(scene, "before", 0, at);
        this.pass(scene, "after", at, width - at);
      });
    }

    pass(scene, side, left, width) {
      if (width <= 0) return;
      this.shared.side.value = SIDES[side];
      this.renderer.setScissor(left, 0, width, this.place.clientHeight);
      this.renderer.render(scene, this.camera);
    }

    listen() {
      const line = this.line, names = ["lit", "wires", "charts", "seams", "texels", "flat"];
      line.addEventListener("pointerdown", (event) => { line.setPointerCapture(event.pointerId); line.focus(); event.preventDefault(); });
      line.addEventListener("pointermove", (event) => {
        if (!line.hasPointerCapture(event.pointerId)) return;
        const box = this.place.getBoundingClientRect();
        this.swipe((100 * (event.clientX - box.left)) / box.width);
      });
      line.addEventListener("keydown", (event) => this.swipeByKey(event));
      for (const name of names) found(this.root, name)?.addEventListener("change", () => this.look());
      found(this.root, "reset")?.addEventListener("click", () => this.reset());
      for (const radio of this.root.querySelectorAll("input[data-show]"))
        radio.addEventListener("change", () => this.present(radio.dataset.show));
      const reach = found(this.root, "reach"), layers = found(this.root, "layer");
      reach.value = this.data.reach;
      reach.addEventListener("input", () => this.limit(Number(reach.value)));
      layers.replaceChildren(...this.layers.map(({ name }, number) => new Option(name, number)));
      layers.parentElement.hidden = this.layers.length < 2;
      layers.addEventListener("change", () => this.choose(Number(layers.value)));
      this.canvas.tabIndex = 0;
      this.canvas.setAttribute("role", "img");
      this.canvas.setAttribute("aria-label", "The model, before to the left of the line and after to its right. Arrow keys turn it, + and - zoom.");
      this.canvas.addEventListener("keydown", (event) => this.turnByKey(event));
      document.addEventListener("keydown", (event) => this.switchByKey(event));
      this.paintScale();
      this.limit(this.data.reach);
      this.swipe(50);
    }

    paintScale() {
      const stops = this.data.scale.map((colour) => `rgb(${colour.map((value) => Math.round(255 * value)).join(" ")})`);
      found(this.root, "gradient").style.background = `linear-gradient(to right, ${stops.join(", ")})`;
    }

    limit(reach) {
      this.shared.reach.value = reach;
      found(this.root, "limit").textContent = `${reach}/255 or more`;
      this.draw();
    }

    swipe(at) {
      this.at = Math.min(100, Math.max(0, at));
      this.line.style.left = `${this.at}%`;
      this.line.setAttribute("aria-valuenow", Math.round(this.at));
      this.line.setAttribute("aria-valuetext", `${Math.round(this.at)} % before, ${100 - Math.round(this.at)} % after`);
      this.draw();
    }

    swipeByKey(event) {
      const steps = { ArrowLeft: -STEP, ArrowDown: -STEP, ArrowRight: STEP, ArrowUp: STEP, PageDown: -10, PageUp: 10, Home: -100, End: 100 };
      if (!(event.key in steps)) return;
      event.preventDefault();
      this.swipe(this.at + steps[event.key]);
    }

    turnByKey(event) {
      const turns = { ArrowLeft: [-TURN, 0], ArrowRight: [TURN, 0], ArrowUp: [0, -TURN], ArrowDown: [0, TURN] };
      const zooms = { "+": 1 / 1.2, "=": 1 / 1.2, "-": 1.2 };
      if (event.key === "0") this.reset();
      if (!(event.key in turns) && !(event.key in zooms)) return;
      event.preventDefault();
      const offset = this.camera.position.clone().sub(this.controls.target), place = new THREE.Spherical().setFromVector3(offset);
      const [right, down] = turns[event.key] || [0, 0];
      if (this.isFlat) {
        const step = new THREE.Vector3(right, -down, 0).multiplyScalar(0.5 * place.radius);
        this.camera.position.add(step);
        this.controls.target.add(step);
      } else {
        place.theta += right;
        place.phi += down;
        place.makeSafe();
      }
      place.radius *= zooms[event.key] || 1;
      this.camera.position.copy(this.controls.target).add(new THREE.Vector3().setFromSpherical(place));
      this.controls.update();
      this.draw();
    }

    // B goes from before to after and back, from wherever the focus is unless keys mean something there.
    switchByKey(event) {
      const busy = event.target.closest?.("input[type=text], select, textarea");
      if (busy || event.ctrlKey || event.metaKey || event.altKey) return;
      const wanted = { b: this.show === "after" ? "before" : "after", d: "difference", s: "swipe" }[event.key.toLowerCase()];
      if (wanted) this.present(wanted);
    }

    present(show) {
      this.show = show;
      this.place.dataset.show = show;
      for (const radio of this.root.querySelectorAll("input[data-show]")) radio.checked = radio.dataset.show === show;
      found(this.root, "legend").hidden = show !== "difference";
      this.draw();
    }
  }

  Viewer.loaded = loaded;
  Viewer.textureOf = textureOf;
  return Viewer;
})();
