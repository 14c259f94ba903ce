// What the viewer uses of three.js (MIT, see three.LICENSE); `make viewer` bundles it into three.js.
export {
  BufferAttribute, BufferGeometry, ClampToEdgeWrapping, DataTexture, DoubleSide, Group, LinearFilter,
  LinearMipmapLinearFilter, LineBasicMaterial, LineSegments, Mesh, MirroredRepeatWrapping, MOUSE, NearestFilter,
  PerspectiveCamera, PlaneGeometry, Points, RepeatWrapping, Scene, ShaderMaterial, Spherical, SRGBColorSpace, Texture,
  TextureLoader, TOUCH, Vector2, Vector3, WebGLRenderer,
} from "three";
export { OrbitControls } from "three/addons/controls/OrbitControls.js";
