// What the report's viewer uses of three.js (MIT, see three.LICENSE); `make viewer` bundles it into three.js.
export {
  BufferAttribute, BufferGeometry, ClampToEdgeWrapping, DoubleSide, Mesh, MeshBasicMaterial, MirroredRepeatWrapping,
  PerspectiveCamera, Points, PointsMaterial, RepeatWrapping, Scene, SRGBColorSpace, TextureLoader, WebGLRenderer,
} from "three";
export { OrbitControls } from "three/addons/controls/OrbitControls.js";
