"""Readers and writers of the formats, imported when they are used, so that the command line starts fast."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from beltrami_cli.formats.changes import Written
    from beltrami_cli.formats.document import Document
    from beltrami_cli.surface.records import MeshContents

    WriteMesh = Callable[[MeshContents, str], Written]

Reader = Literal["image", "ply", "obj", "gltf", "usd", "text points", "survey", "npz points", "read only"]
Writer = Literal["ply", "obj", "glb", "gltf", "usdz", "usda", "usdc", "xyz", "pts", "csv", "npz"]


def document_class(reader: Reader) -> type[Document]:
    Opened: type[Document]  # noqa: N806  (a class)
    match reader:
        case "image":
            from beltrami_cli.formats.image_document import ImageDocument as Opened
        case "ply":
            from beltrami_cli.formats.ply.document import PlyDocument as Opened
        case "obj":
            from beltrami_cli.formats.obj.document import ObjDocument as Opened
        case "gltf":
            from beltrami_cli.formats.gltf.document import GltfDocument as Opened
        case "usd":
            from beltrami_cli.formats.usd.document import UsdDocument as Opened
        case "text points":
            from beltrami_cli.formats.points.text_document import TextPointsDocument as Opened
        case "survey":
            from beltrami_cli.formats.points.survey import SurveyDocument as Opened
        case "npz points":
            from beltrami_cli.formats.points.npz import NpzPointsDocument as Opened
        case "read only":
            from beltrami_cli.formats.read_only.document import ReadOnlyDocument as Opened
    return Opened


def mesh_writer(writer: Writer) -> WriteMesh:
    """Return the function that makes the files of a mesh, named after a stem."""
    write: WriteMesh
    match writer:
        case "ply":
            from beltrami_cli.formats.ply.writer import write_ply as write
        case "obj":
            from beltrami_cli.formats.obj.writer import write_obj as write
        case "glb":
            from beltrami_cli.formats.gltf.writer import write_glb as write
        case "gltf":
            from beltrami_cli.formats.gltf.writer import write_gltf as write
        case "usdz":
            from beltrami_cli.formats.usd.writer import write_usdz as write
        case "usda":
            from beltrami_cli.formats.usd.writer import write_usda as write
        case "usdc":
            from beltrami_cli.formats.usd.writer import write_usdc as write
        case "xyz":
            from beltrami_cli.formats.points.text_document import write_xyz as write
        case "pts":
            from beltrami_cli.formats.points.text_document import write_pts as write
        case "csv":
            from beltrami_cli.formats.points.text_document import write_csv as write
        case "npz":
            from beltrami_cli.formats.points.npz import write_npz as write
    return write
