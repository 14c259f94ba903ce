// Shows new colours: of all or some vertices, of a texture, or of a part of one.
"use strict";
const Patching = (() => {
  class Patching {
    constructor(viewer) {
      this.viewer = viewer;
    }

    async apply(patches) {
      for (const patch of patches) {
        const layer = this.viewer.layers[patch.layer];
        if (patch.colours) await this.patchVertices(layer, patch);
        else if (patch.source) await this.patchTexture(layer, patch);
        else await this.patchTexels(layer, patch);
      }
      this.viewer.draw();
    }

    async patchVertices(layer, patch) {
      const rows = new Uint32Array(await Unpacking.inflated(patch.rows)), colours = new Uint16Array(await Unpacking.inflated(patch.colours));
      const { _after: after } = layer.meshes[0].geometry.attributes;
      for (let at = 0; at < rows.length; at++)
        for (let channel = 0; channel < 3; channel++) after.array[4 * rows[at] + channel] = colours[3 * at + channel];
      after.needsUpdate = true;
      if (patch.places) this.move(layer, rows, new Float32Array(await Unpacking.inflated(patch.places)));
    }

    // Vertices that are smoothed along with their colours.
    move(layer, rows, places) {
      const { geometry, material } = layer.meshes[0];
      const { position, _moved: moved = new THREE.BufferAttribute(new Float32Array(3 * position.count), 3) } = geometry.attributes;
      if (!geometry.attributes._moved) {
        for (let at = 0; at < position.count; at++) moved.setXYZ(at, position.getX(at), position.getY(at), position.getZ(at));
        geometry.setAttribute("_moved", moved);
      }
      rows.forEach((row, at) => moved.array.set(places.subarray(3 * at, 3 * at + 3), 3 * row));
      moved.needsUpdate = true;
      material.uniforms.moves.value = 1;
    }

    // The parts with a texture, by its number in the layer.
    using(layer, number) {
      return layer.textured.filter(([textures]) => textures && textures[0] === layer.pairs[number][0]);
    }

    async patchTexture(layer, patch) {
      const { image } = await Viewer.loaded(patch.source), parts = this.using(layer, patch.texture);
      if (parts.length) this.replace(parts, image);
    }

    replace(parts, image) {
      const { uniforms } = parts[0][1], old = uniforms.mapFresh.value, made = uniforms.mapOld.value.clone();
      made.source = new THREE.Source(image);
      made.needsUpdate = true;
      this.viewer.refilter(made);
      for (const [, material] of parts) material.uniforms.mapFresh.value = made;
      if (old !== uniforms.mapOld.value) old.dispose();
      return made;
    }

    async patchTexels(layer, patch) {
      const parts = this.using(layer, patch.texture), { uniforms } = parts[0][1];
      let map = uniforms.mapFresh.value;
      if (map === uniforms.mapOld.value) map = this.replace(parts, map.image);
      const pixels = new Uint8Array(await Unpacking.inflated(patch.pixels));
      const piece = new THREE.DataTexture(pixels, patch.width, patch.height);
      piece.colorSpace = THREE.SRGBColorSpace;
      piece.needsUpdate = true;
      this.viewer.renderer.initTexture(map);
      this.viewer.renderer.copyTextureToTexture(piece, map, null, new THREE.Vector2(patch.x, patch.y));
      piece.dispose();
    }
  }

  return Patching;
})();
