// Makes the drawn objects of a model: meshes, points, flat textures, wireframes and seams, and the shaders that draw them.
"use strict";
const Shapes = (() => {
  const VERTEX = `
    attribute vec3 _moved, _before, _after;
    attribute float _chart;
    uniform int side;
    uniform float disc, moves, high;
    varying vec2 place;
    varying vec3 old, fresh, seen;
    flat varying float number;
    vec3 light(vec3 c) { return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(0.04045, c)); }
    void main() {
      place = uv; old = light(_before); fresh = light(_after); number = _chart;
      vec4 from = modelViewMatrix * vec4(side == 0 || moves == 0.0 ? position : _moved, 1.0);
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
    constructor(maps, shared) {
      Object.assign(this, { maps, shared });
    }

    // A scene of the file as a layer: its meshes, points and lines, and its textures laid flat.
    layerOf(solid) {
      const flat = new THREE.Group(), shapes = [...solid.children];
      solid.position.set(...solid.userData.middle.map((value) => -value));
      const layer = { ...solid.userData, solid, flat, materials: [], textured: [], meshes: [], wires: [], seams: [] };
      const lines = shapes.filter((shape) => shape.isLineSegments);
      layer.meshes = shapes.filter((shape) => !shape.isLineSegments);
      for (const shape of layer.meshes) this.addShape(layer, shape);
      this.addSheets(layer, lines);
      for (const { geometry, userData } of lines)
        if (!userData.textures) layer.seams.push(this.lines(geometry.attributes.position, 0xd55e00, solid));
      solid.remove(...lines);
      return layer;
    }

    addShape(layer, shape) {
      const { textures = null, hides = false, size = 0 } = shape.userData, { _before: coloured, _moved: moved } = shape.geometry.attributes;
      shape.material = this.material({ textures, hides, size, coloured, moved, points: shape.isPoints });
      shape.frustumCulled = false;
      layer.materials.push(shape.material);
      layer.textured.push([textures, shape.material]);
      if (!shape.isPoints) layer.wires.push(this.wires(shape.geometry, layer.solid));
    }

    material({ textures = null, hides = false, size = 0, coloured, moved, points = false }) {
      const [old, fresh] = textures ? textures.map((number) => this.maps[number]) : [null, null];
      const own = {
        disc: size, moves: moved ? 1 : 0, hides: hides ? 1 : 0, textured: old ? 1 : 0, plain: old || coloured ? 0 : 1,
        discs: points ? 1 : 0, mapOld: old, mapFresh: fresh,
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
    addSheets(layer, lines) {
      const { pairs: all = [], meshes, flatOnly } = layer, isOf = ([old]) => ({ userData }) => userData.textures?.[0] === old;
      const used = all.filter((pair) => flatOnly || meshes.some(isOf(pair)));
      const pairs = [...new Map(used.map((pair) => [pair[0], pair])).values()];
      const sizes = pairs.map(([old]) => this.maps[old].image).map((image) => image.width / image.height);
      const total = sizes.reduce((sum, size) => sum + size, 0) + 0.05 * (pairs.length - 1);
      let left = -total / 2;
      pairs.forEach((pair, number) => {
        const sheet = new THREE.Group(), plane = new THREE.PlaneGeometry(1, 1), material = this.material({ textures: pair });
        sheet.userData.number = all.findIndex(([old]) => old === pair[0]);
        plane.attributes.uv.array.set([0, 0, 1, 0, 0, 1, 1, 1]);
        material.uniforms.charts = { value: 0 };
        layer.materials.push(material);
        layer.textured.push([pair, material]);
        sheet.add(new THREE.Mesh(plane, material));
        sheet.scale.set(sizes[number], 1, 1);
        sheet.position.x = left + sizes[number] / 2;
        for (const mesh of meshes.filter(isOf(pair))) this.addFlat(layer, mesh, sheet);
        for (const { geometry } of lines.filter(isOf(pair)))
          layer.seams.push(this.lines(geometry.attributes.position, 0xd55e00, sheet));
        layer.flat.add(sheet);
        left += sizes[number] + 0.05;
      });
      layer.flat.scale.setScalar(1 / Math.max(1, total));
    }

    addFlat(layer, mesh, sheet) {
      const { uv, _chart } = mesh.geometry.attributes, places = new Float32Array(3 * uv.count);
      for (let at = 0; at < uv.count; at++) places.set([uv.getX(at) - 0.5, 0.5 - uv.getY(at), 0.001], 3 * at);
      const geometry = new THREE.BufferGeometry().setIndex(mesh.geometry.index);
      Object.entries({ position: new THREE.BufferAttribute(places, 3), uv, _chart }).forEach((each) => geometry.setAttribute(...each));
      const tinted = new THREE.Mesh(geometry, mesh.material);
      tinted.visible = false;
      layer.tints = [...(layer.tints || []), tinted];
      sheet.add(tinted);
      layer.wires.push(this.wires(geometry, sheet));
    }
  }

  return Shapes;
})();
