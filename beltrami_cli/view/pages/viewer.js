// Two models under one camera, before to the left of the swipe and after to its right.
"use strict";
(() => {
  const place = document.getElementById("viewer");
  const range = document.getElementById("swipe");
  const data = JSON.parse(document.getElementById("models").textContent);
  const WRAPS = { repeat: THREE.RepeatWrapping, mirror: THREE.MirroredRepeatWrapping, clamp: THREE.ClampToEdgeWrapping };

  const FIELD = 30; // degrees
  const HALF_FIELD = Math.tan((FIELD * Math.PI) / 360); // three.js leaves it out of the sizes of points

  const bytes = (key) => Uint8Array.from(atob(data.buffers[key]), (letter) => letter.charCodeAt(0)).buffer;
  const loading = [];

  function texture(described) {
    const made = new Promise((resolve, reject) => {
      const loaded = new THREE.TextureLoader().load(described.source, () => resolve(), undefined, reject);
      loaded.flipY = false; // v points down here
      loaded.colorSpace = THREE.SRGBColorSpace;
      [loaded.wrapS, loaded.wrapT] = described.wrap.map((mode) => WRAPS[mode]);
      described.loaded = loaded;
    });
    loading.push(made);
    return described.loaded;
  }

  function part(described, maps) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(bytes(described.position)), 3));
    if (described.uv) geometry.setAttribute("uv", new THREE.BufferAttribute(new Float32Array(bytes(described.uv)), 2));
    if (described.colour)
      geometry.setAttribute("color", new THREE.BufferAttribute(new Uint16Array(bytes(described.colour)), 3, true));
    if (described.index) geometry.setIndex(new THREE.BufferAttribute(new Uint32Array(bytes(described.index)), 1));
    const look = { vertexColors: Boolean(described.colour) };
    if (described.kind === "points")
      return new THREE.Points(geometry, new THREE.PointsMaterial({ ...look, size: described.size / HALF_FIELD }));
    const map = described.texture === null ? null : maps[described.texture];
    const hides = map && data.textures[described.texture].hides;
    const material = { ...look, map, side: THREE.DoubleSide, alphaTest: hides ? 0.5 : 0 };
    if (!map && !described.colour) material.color = 0x999999;
    return new THREE.Mesh(geometry, new THREE.MeshBasicMaterial(material));
  }

  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
  } catch (error) {
    place.textContent = "This browser has no WebGL, which the view of the models needs.";
    return;
  }
  renderer.setPixelRatio(window.devicePixelRatio);
  renderer.setScissorTest(true);
  place.prepend(renderer.domElement);

  const maps = data.textures.map(texture);
  const scenes = data.models.map((parts) => {
    const scene = new THREE.Scene();
    for (const described of parts) scene.add(part(described, maps));
    return scene;
  });
  // The box of the models is centred, and its longest side is 1.
  const camera = new THREE.PerspectiveCamera(FIELD, 1, 0.01, 100);
  camera.position.set(0, 0, 2.4);
  const controls = new THREE.OrbitControls(camera, renderer.domElement);

  function draw() {
    const width = place.clientWidth, height = place.clientHeight, at = (width * range.value) / 100;
    scenes.forEach((scene, number) => {
      renderer.setClearColor(0xffffff);
      renderer.setScissor(number ? at : 0, 0, number ? width - at : at, height);
      renderer.render(scene, camera);
    });
  }

  function resize() {
    renderer.setSize(place.clientWidth, place.clientHeight);
    camera.aspect = place.clientWidth / place.clientHeight;
    camera.updateProjectionMatrix();
    draw();
  }

  controls.addEventListener("change", draw);
  range.addEventListener("input", draw);
  window.addEventListener("resize", resize);
  Promise.all(loading).then(() => {
    resize();
    place.dataset.ready = "yes";
  });
})();
