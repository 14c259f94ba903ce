// Shows new colours: of all or some vertices, of a texture, or of a part of one.
"use strict";
const Painting = (() => {
  class Painting {
    constructor(viewer) {
      this.viewer = viewer;
    }

    async paint(patches) {
      for (const patch of patches) {
        const layer = this.viewer.layers[patch.layer];
        if (patch.colours) await this.paintVertices(layer, patch);
        else if (patch.source) await this.paintTexture(layer, patch);
        else await this.paintTexels(layer, patch);
      }
      this.viewer.draw();
    }

    async paintVertices(layer, patch) {
      const rows = new Uint32Array(await Unpacking.inflated(patch.rows)), colours = new Uint16Array(await Unpacking.inflated(patch.colours));
      const { after } = layer.meshes[0].geometry.attributes;
      for (let at = 0; at < rows.length; at++)
        for (let channel = 0; channel < 3; channel++) after.array[3 * rows[at] + channel] = colours[3 * at + channel];
      after.needsUpdate = true;
      if (patch.places) this.move(layer, rows, new Uint16Array(await Unpacking.inflated(patch.places)));
    }

    // Vertices that are smoothed along with their colours.
    move(layer, rows, places) {
      const { geometry, material } = layer.meshes[0];
      if (!geometry.attributes.moved) geometry.setAttribute("moved", geometry.attributes.position.clone());
      const { moved } = geometry.attributes;
      for (let at = 0; at < rows.length; at++)
        for (let axis = 0; axis < 3; axis++) moved.array[3 * rows[at] + axis] = places[3 * at + axis];
      moved.needsUpdate = true;
      material.uniforms.moves.value = 1;
    }

    // The parts with a texture, by its number in the layer.
    using(layer, number) {
      const first = layer.numbers[number];
      return layer.textured.filter(([part]) => part.textures && part.textures[0] === first);
    }

    async paintTexture(layer, patch) {
      const { image } = await Viewer.loaded(patch.source), parts = this.using(layer, patch.texture);
      if (parts.length) this.replace(parts, image);
    }

    replace(parts, image) {
      const { uniforms } = parts[0][1], old = uniforms.mapFresh.value;
      const made = Viewer.textureOf(image, this.viewer.data.textures[parts[0][0].textures[0]].wrap);
      this.viewer.refilter(made);
      for (const [, material] of parts) material.uniforms.mapFresh.value = made;
      if (old !== uniforms.mapOld.value) old.dispose();
      return made;
    }

    async paintTexels(layer, patch) {
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

  return Painting;
})();
