"""glTF 2.0 and GLB: vertex colours, their places and images are replaced, everything else is kept."""

from beltrami_cli.formats.gltf.document import GltfDocument
from beltrami_cli.formats.gltf.textured_writer import write_textured_glb, write_textured_gltf
from beltrami_cli.formats.gltf.writer import write_glb, write_gltf

__all__ = ["GltfDocument", "write_glb", "write_gltf", "write_textured_glb", "write_textured_gltf"]
