// Shows new colours: of all or some vertices, of a texture, or of a part of one.
"use strict";
const Updating = (() => {
  class Updating {
    constructor(viewer) {
      this.viewer = viewer;
    }

    async apply(updates) {
      for (const update of updates) {
        const layer = this.viewer.layers[update.layer];
        if (update.colours) await this.updateVertices(layer, update);
        else if (update.source) await this.updateTexture(layer, update);
        else await this.updateTexels(layer, update);
      }
      this.viewer.draw();
    }

    async updateVertices(layer, update) {
      const rows = new Uint32Array(await Unpacking.inflated(update.rows)), colours = new Uint16Array(await Unpacking.inflated(update.colours));
      const { _after: after } = layer.meshes[0].geometry.attributes;
      for (let at = 0; at < rows.length; at++)
        for (let channel = 0; channel < 3; channel++) after.array[4 * rows[at] + channel] = colours[3 * at + channel];
      after.needsUpdate = true;
      if (update.places) this.move(layer, rows, new Float32Array(await Unpacking.inflated(update.places)));
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

    async updateTexture(layer, update) {
      const { image } = await Viewer.loaded(update.source), parts = this.using(layer, update.texture);
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

    async updateTexels(layer, update) {
      const parts = this.using(layer, update.texture), { uniforms } = parts[0][1];
      let map = uniforms.mapFresh.value;
      if (map === uniforms.mapOld.value) map = this.replace(parts, map.image);
      const pixels = new Uint8Array(await Unpacking.inflated(update.pixels));
      const piece = new THREE.DataTexture(pixels, update.width, update.height);
      piece.colorSpace = THREE.SRGBColorSpace;
      piece.needsUpdate = true;
      this.viewer.renderer.initTexture(map);
      this.viewer.renderer.copyTextureToTexture(piece, map, null, new THREE.Vector2(update.x, update.y));
      piece.dispose();
    }
  }

  return Updating;
})();
