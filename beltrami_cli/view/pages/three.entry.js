// What the viewer uses of three.js (MIT, see three.LICENSE); `make viewer` bundles it into three.js.
export {
  BufferAttribute, BufferGeometry, DataTexture, DoubleSide, Group, LinearFilter, LineBasicMaterial, LineSegments, Mesh,
  MOUSE, NearestFilter, PerspectiveCamera, PlaneGeometry, ShaderMaterial, Source, Spherical, SRGBColorSpace, TextureLoader,
  TOUCH, Vector2, Vector3, WebGLRenderer,
} from "three";
export { OrbitControls } from "three/addons/controls/OrbitControls.js";
export { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
