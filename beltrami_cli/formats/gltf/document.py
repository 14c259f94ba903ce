"""A glTF 2.0 file, text or binary, of which only vertex colours, their places and images are replaced."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access
from beltrami_cli.formats.document import NO_IMAGES, Document
from beltrami_cli.formats.gltf.accessors import Accessors, Stored, fractions
from beltrami_cli.formats.gltf.anatomy import take_apart
from beltrami_cli.formats.gltf.attributes import attribute_names, read_attribute
from beltrami_cli.formats.gltf.buffers import Buffers
from beltrami_cli.formats.gltf.container import read_container
from beltrami_cli.formats.gltf.contents import contents_of, has_colours, normals_of, summary
from beltrami_cli.formats.gltf.editing import Edit
from beltrami_cli.formats.gltf.materials import present_slots
from beltrami_cli.formats.gltf.moving import move, require_movable
from beltrami_cli.formats.gltf.patching import recolour
from beltrami_cli.formats.gltf.pictures import Pictures
from beltrami_cli.formats.gltf.primitives import in_world
from beltrami_cli.formats.gltf.recompressing import compress_again
from beltrami_cli.formats.gltf.references import present
from beltrami_cli.formats.gltf.repackaging import as_glb, as_gltf
from beltrami_cli.formats.gltf.repainting import repaint
from beltrami_cli.formats.gltf.saving import written
from beltrami_cli.formats.gltf.scene import placements
from beltrami_cli.formats.gltf.structure import require_structure
from beltrami_cli.formats.gltf.surfaces import COLOUR_TYPES, Surface, gather
from beltrami_cli.formats.gltf.texturing import gather_textured
from beltrami_cli.formats.model_folder import ModelFolder
from beltrami_cli.surface.records import MeshContents, MovedVertices, PaintedVertices

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Fingerprint, Written
    from beltrami_cli.surface.records import ImageFile, Slot, TexturedSurface


GltfForm = Literal["glb", "gltf"]
"""Binary or text."""


class GltfDocument(Document):
    """An opened glTF file.

    Parameters
    ----------
    data : bytes
        The main file: GLB, or JSON text in UTF-8.
    name : str
        The file as the user named it.
    folder : pathlib.Path or None
        Where buffers and images beside the file are looked for; None when it came through a pipe.
    access : Access
        What may be read.

    Raises
    ------
    InputError
        If the file is damaged, not glTF 2, or its JSON describes what cannot be.

    Attributes
    ----------
    format : str
        "glb" or "gltf", by content.
    """

    format: str  # type: ignore[misc]  # one class reads both forms, so only an instance knows its format

    def __init__(
        self, data: bytes, name: str, folder: Path | None, access: Access = EVERYTHING_INSIDE
    ) -> None:
        super().__init__(name)
        self._beside = ModelFolder(folder, access)
        self.container = read_container(data, name)
        self.format = self.container.kind
        self.root = self.container.root
        require_structure(self.root)
        self.buffers = Buffers(self.container, self._beside)
        self.accessors = Accessors(self.root, self.buffers)
        self.places = placements(self.root)
        self.pictures = Pictures(self.root, self.accessors, self._beside)
        self._textured: dict[Slot, TexturedSurface] = {}
        self._references, missing = present(self.root, self._beside)
        if self.container.has_bom:
            self.notices.append(
                "The JSON starts with a byte order mark, which glTF does not allow; it is kept."
            )
        self.notices += missing

    @cached_property
    def surface(self) -> Surface:
        """Painted primitives; the user is told about the others when this is first asked for."""
        surface = gather(self.root, self.accessors, self.places)
        self.notices += surface.notices
        return surface

    @cached_property
    def stored_colours(self) -> list[Stored]:
        """Colours of every block as stored, each of shape (rows of the block, 3 or 4)."""
        stored = [self.accessors.stored(block.colour) for block in self.surface.blocks]
        for block, numbers in zip(self.surface.blocks, stored, strict=True):
            if numbers.dtype.kind == "f" and not np.isfinite(numbers).all():
                row = int(np.nonzero(~np.isfinite(numbers).all(axis=1))[0][0])
                raise self.accessors[block.colour].entry.fault(
                    "", f"colour {row} is not finite", "repair the file"
                )
        return stored

    @cached_property
    def _painted(self) -> PaintedVertices:
        surface = self.surface
        colours = np.concatenate([fractions(numbers[:, :3]) for numbers in self.stored_colours])
        stored = {numbers.dtype.name for numbers in self.stored_colours}
        spaces = np.concatenate(
            [np.full(block.count, block.placement.space, np.int32) for block in surface.blocks]
        )
        positions = [
            in_world(self.accessors.values(block.position), block.placement, self.accessors, block.position)
            for block in surface.blocks
        ]
        return PaintedVertices(
            positions=np.concatenate(positions),
            faces=surface.faces,
            colours=colours,
            channels=("red", "green", "blue"),
            encoding="linear",
            stored=next(kind for kind in COLOUR_TYPES if kind in stored),
            space_of=spaces if np.any(spaces != spaces[0]) else None,
        )

    def painted(self) -> PaintedVertices:  # noqa: D102
        return self._painted

    def has_vertex_colours(self) -> bool:
        """Tell whether any primitive has COLOR_0, read or not."""
        return has_colours(self.container.tree)

    def slots(self) -> tuple[Slot, ...]:  # noqa: D102
        return present_slots(self.root)

    def textured(self, slot: Slot) -> TexturedSurface:  # noqa: D102
        if slot not in self._textured:
            surface, notices = gather_textured(self.root, self.accessors, self.places, self.pictures, slot)
            self._textured[slot] = surface
            self.notices += [notice for notice in notices if notice not in self.notices]
        return self._textured[slot]

    def attributes(self) -> tuple[str, ...]:  # noqa: D102
        return attribute_names(self.root, self.surface.blocks)

    def attribute(self, name: str) -> NDArray[np.float64]:  # noqa: D102
        fits = [known for known in self.attributes() if known.lower() == name.lower()]
        if not fits:
            return super().attribute(name)
        if fits[0] == "normal" and (normals := normals_of(self)) is not None:
            return normals.astype(np.float64)
        return read_attribute(self.root, self.surface.blocks, self.accessors, fits[0])

    def require_movable(self) -> None:  # noqa: D102
        require_movable(self.accessors, self.surface.blocks)

    def edit(
        self,
        colours: NDArray[np.float32] | None,
        images: Mapping[tuple[Slot, str], ImageFile],
        places: MovedVertices | None = None,
    ) -> Edit:
        """Return the JSON and the buffers with other colours, images and places; all as for `patch`."""
        edit = Edit(self.container, self.accessors, self.container.copy_of_tree())
        if colours is not None:
            recolour(edit, self.surface.blocks, self.stored_colours, self.painted().colours, colours)
        if places is not None:
            move(edit, self.surface.blocks, self.painted().positions, places)
        compress_again(edit)
        repaint(edit, self.pictures, images)
        return edit

    def patch(  # noqa: D102
        self,
        colours: NDArray[np.float32] | None,
        stem: str,
        *,
        moved: bool,
        images: Mapping[tuple[Slot, str], ImageFile] = NO_IMAGES,
        places: MovedVertices | None = None,
    ) -> Written:
        return written(self.edit(colours, images, places), stem, moved=moved)

    def repackaged(
        self,
        colours: NDArray[np.float32] | None,
        stem: str,
        form: GltfForm,
        *,
        moved: bool,
        images: Mapping[tuple[Slot, str], ImageFile] = NO_IMAGES,
        places: MovedVertices | None = None,
    ) -> Written:
        """Return the document as `patch` does, in the other form of glTF if that is asked for.

        Parameters
        ----------
        colours, stem, moved, images, places
            As for `patch`.
        form : {"glb", "gltf"}
            Binary or text. Going to "glb", buffers are merged into the BIN chunk and images inside the
            folder embedded; going to "gltf", the BIN chunk becomes the sidecar ``{stem}.bin``.

        Raises
        ------
        InputError
            If a buffer that has to be moved cannot be read.
        """
        edit = self.edit(colours, images, places)
        if form == self.format:
            return written(edit, stem, moved=moved)
        return as_glb(edit, self._beside) if form == "glb" else as_gltf(edit, stem, moved=moved)

    def references(self) -> Sequence[str]:
        """Return relative paths of the existing buffers and images beside the file ("/" separates).

        Buffers whose colours a patch changes are among them: a sidecar of the same name takes precedence.
        """
        return self._references

    def contents(self) -> MeshContents:  # noqa: D102
        return contents_of(self)

    def fingerprint(self) -> Fingerprint:  # noqa: D102
        return take_apart(self)

    def facts(self) -> dict[str, object]:  # noqa: D102
        return summary(self)
