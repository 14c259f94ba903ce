"""What is exchanged with the process with usd-core, as JSON: requests, and the records of a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, TypedDict

from beltrami_cli.arrays import Array
from beltrami_cli.errors import Obstacle
from beltrami_cli.formats.usd.preview_surface import MaterialInputs
from beltrami_cli.surface.records import Slot, Wrap
from beltrami_cli.surface.worker_process import Message

Count = Literal[
    "animated", "bare", "flat", "further", "hidden", "instanced", "no mesh", "transparent", "uncoloured", "unfit",
    "unread",
]  # fmt: skip
"""What is counted of a scene: parts that are skipped or special, most of which `document` has a notice for."""


class SceneRequest(TypedDict):
    """A request about the scene whose layers are in the working folder."""

    root: str
    layers: list[str]
    refused: Sequence[Sequence[str]]  # pairs of a layer, and a path in it that is left out


class TextRequest(SceneRequest):
    """The attributes whose values the text leaves out."""

    images: list[str]
    colours: list[str]


class EditRequest(SceneRequest):
    """New values; the colours are in the array of that name."""

    blocks: list[dict[str, Any]]  # each a `ColourBlock`
    files: dict[str, str]  # new names of images, by attribute
    suffix: str  # of the form in which the layer is wanted; "": its own


@dataclass(frozen=True)
class TextureUse:
    """An image that a material shows in a slot."""

    material: int
    slot: Slot
    attribute: str  # path of the shader's attribute that names the image
    file: str  # relative to the folder of the root layer
    wrap: tuple[Wrap, Wrap]


@dataclass(frozen=True)
class ColourBlock:
    """The rows of one mesh among the colours of all meshes."""

    attribute: str  # path of its displayColor
    first: int
    count: int
    type: str  # stored type, by NumPy's name

    @property
    def rows(self) -> slice:
        return slice(self.first, self.first + self.count)


@dataclass(frozen=True)
class SceneContents:
    """A scene.

    `arrays` has, of the V points, P polygons, K corners and C vertex colours of all meshes:

    - positions (V, 3): in world space
    - sizes (P,): corners of each polygon
    - material_of, mesh_of (P,): indices into `materials` (-1: none) and `meshes`
    - corners, rows (K,): indices of the points, and of the colours (-1: none)
    - normals (K, 3): of unit length; NaN: none
    - uv, "uv SLOT" (K, 2): texture coordinates, v up, as stored and as the images of a slot are placed; NaN: none
    - colours (C, 3), opacity (C,): in linear light
    - colour_vertex (C,): indices of the points

    Those without rows may be missing.
    """

    uses: tuple[TextureUse, ...]
    images: Mapping[str, str]  # all images that the layers name, by attribute
    materials: tuple[MaterialInputs, ...]
    blocks: tuple[ColourBlock, ...]
    meshes: tuple[str, ...]  # names
    counts: Mapping[Count, int]
    slots: tuple[Slot, ...]
    others: tuple[str, ...]  # types of geometry other than meshes
    up: str
    unit: float  # metres
    variants: tuple[str, ...]
    arrays: Mapping[str, Array]
    # Layers that are not read, by their paths; known outside of the process.
    unread: Mapping[str, Obstacle] = field(default_factory=dict)

    def to_message(self) -> Message:
        return asdict(replace(self, arrays={})), dict(self.arrays)

    @classmethod
    def from_message(
        cls, answer: Mapping[str, Any], arrays: Mapping[str, Array], unread: Mapping[str, Obstacle]
    ) -> SceneContents:
        """Make the record from what JSON left of `to_message`."""
        records = {
            "arrays": arrays,
            "unread": unread,
            "uses": tuple(TextureUse(**{**each, "wrap": tuple(each["wrap"])}) for each in answer["uses"]),
            "materials": tuple(MaterialInputs(**each) for each in answer["materials"]),
            "blocks": tuple(ColourBlock(**each) for each in answer["blocks"]),
        }
        names = {key: tuple(answer[key]) for key in ("meshes", "slots", "others", "variants")}
        return cls(**{**answer, **names, **records})
