// Makes what is drawn of a model: meshes, points, flat textures, wireframes and seams, and the shaders that draw them.
"use strict";
const Shapes = (() => {
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

  class Shapes {
    constructor(data, arrays, images, maps, shared) {
      Object.assign(this, { data, arrays, images, maps, shared });
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

    positions(key, index = null) {
      return this.attribute(key, index, 3, Uint16Array, (value) => value, true);
    }

    // Whole numbers of each vertex, as an attribute of some type.
    attribute(key, index, columns, kind, each, isShare = false) {
      const rows = Unpacking.restored(this.arrays[key], index);
      return new THREE.BufferAttribute(kind.from(rows, each), columns, isShare);
    }

    addPart(layer, part) {
      const geometry = new THREE.BufferGeometry(), index = part.index ? Unpacking.triangles(this.arrays[part.index]) : null;
      const set = (name, attribute) => geometry.setAttribute(name, attribute);
      set("position", this.positions(part.position, index));
      if (part.moved) set("moved", this.positions(part.moved, index));
      if (part.colours)
        ["before", "after"].forEach((name, side) =>
          set(name, this.attribute(part.colours[side], index, 3, Uint16Array, (value) => value * part.depth, true)));
      if (part.uv) set("uv", this.coordinates(part, part.uv, index));
      if (part.charts) set("chart", this.attribute(part.charts, index, 1, Uint16Array, (value) => value));
      if (index) geometry.setIndex(new THREE.BufferAttribute(index, 1));
      const material = this.material(part);
      const shape = part.kind === "points" ? new THREE.Points(geometry, material) : new THREE.Mesh(geometry, material);
      shape.frustumCulled = false;
      layer.materials.push(material);
      layer.textured.push([part, material]);
      layer.meshes.push(shape);
      layer.solid.add(shape);
      if (part.index) layer.wires.push(this.wires(geometry, layer.solid));
    }

    coordinates(part, key, index) {
      return this.attribute(key, index, 2, Float32Array, (value, at) => value / part.steps[at % 2]);
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
      const borders = this.coordinates(part, part.borders, null).array, ends = new Float32Array((3 * borders.length) / 2);
      for (let at = 0; at < borders.length / 2; at++)
        ends.set([borders[2 * at] - 0.5, 0.5 - borders[2 * at + 1], 0.002], 3 * at);
      layer.seams.push(this.lines(new THREE.BufferAttribute(ends, 3), 0xd55e00, sheet));
    }
  }

  return Shapes;
})();
