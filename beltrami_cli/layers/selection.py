"""Selection of the parts of a document that are recoloured, and their layers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.arrays import Float64s, Int32s
from beltrami_cli.errors import InputError, NoColoursError, Obstacle, UsageError
from beltrami_cli.fields import given_parameters, require_effect
from beltrami_cli.flow.chunks import chunk_memory
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.sizes import measure_image
from beltrami_cli.layers.image_memory import require_memory, sizes_of, too_large
from beltrami_cli.layers.layer import Layer
from beltrami_cli.layers.settings import SmoothSettings, binding_parameters
from beltrami_cli.layers.texture_groups import choose_textures, covered_texels, separate_surfaces
from beltrami_cli.layers.texture_layer import TextureLayer
from beltrami_cli.surface.large_arrays import arrays_in_files
from beltrami_cli.surface.precision import coarse_rounding, require_scale
from beltrami_cli.surface.records import TexturedSurface
from beltrami_cli.surface.slots import SLOTS, Slot

if TYPE_CHECKING:
    from beltrami_cli.layers.vertex_layer import VertexLayer


_TEXT_POINTS = ("xyz", "pts", "csv")  # formats

# Texels that take as long as one vertex, for progress.
_TEXELS_OF_A_VERTEX = 6

# Bytes per texel of all textures, or per pixel of an image, that stay in memory while large arrays are in files: masks.
# 16 textures of 2048 x 2048, limited to 180 MB, took 270 MB, with 90 of the program itself and arrays of 45: 2.0 a
# texel.
_MASKS = 2


@dataclass(frozen=True)
class Selection:
    """The selected parts of a document: vertex colours, textures of slots, or the image itself."""

    document: Document
    settings: SmoothSettings
    vertices: bool = False
    slots: tuple[Slot, ...] = ()
    image: bool = False
    # Notices of what was asked for and is not there, or is there and not selected.
    left_out: tuple[str, ...] = ()

    @property
    def notices(self) -> list[str]:
        """What users should know of the selected parts and their guides, besides `Document.notices`."""
        found = [*self.document.coloured_vertices().notices] if self.vertices else []
        guides = {name.lower() for name in self.settings.embedding.guides} if self.slots else set()
        guiding = [slot for slot in self.document.slots() if slot.lower() in guides]
        for slot in (*self.slots, *guiding):
            found += self.document.textured(slot).notices
        return [*dict.fromkeys([*found, *self.left_out])]

    @cached_property
    def surfaces(self) -> tuple[TexturedSurface, ...]:
        """The surface of each slot with the selected textures."""
        surfaces = map(self.document.textured, self.slots)
        return tuple(choose_textures(surface, self.settings.textures) for surface in surfaces)

    @property
    def kinds(self) -> list[str]:
        """The kinds of input, as in `Parameter.of`."""
        kinds = {
            "vertex colours": self.vertices,
            "textures": bool(self.slots),
            "images": self.image or (self.vertices and self.document.grid() is not None),
            "level sets": self.document.kind == "volume",
            "points in text files": self.document.format in _TEXT_POINTS,
        }
        return [kind for kind, is_there in kinds.items() if is_there]

    def images(self) -> Iterator[Iterator[tuple[str, bytes]]]:
        """Yield names and bytes of files that are recoloured together: the image, or the textures of each slot."""
        if self.image:
            yield iter([(self.document.name, self.document.data)])
        for surface in self.surfaces:
            yield ((texture.name, texture.data) for texture in surface.textures)

    def require_memory(self, work: str = "recoloured") -> None:
        """Raise InputError if images do not fit into memory, slot by slot; `work`: see `require_memory`."""
        for images in self.images():
            require_memory(images, self.document.access, work)

    @contextmanager
    def within_memory(self, target: str | None = None, *, in_files: bool = True) -> Iterator[int | None]:
        """Put large arrays into files in the folder of `target` if memory is too small for all of them.

        Yield the bytes that a chunk of a mesh may take; None: meshes are not cut. InputError if memory is too small
        even so, or if arrays must stay in memory (not `in_files`), as for work that makes many of them. Besides arrays
        there must be room for one decoded image and for the new file, which is about as large as the old one, with and
        without its metadata.
        """
        if not in_files:
            self.require_memory("smoothed")
        if self.document.access.memory is None or not in_files:
            yield None
            return
        left = memory = self.document.access.memory - len(self.document.data)
        for images in self.images():
            largest = texels = 0
            for name, size, stored in sizes_of(images):
                largest, texels = max(largest, size.decoded + 2 * stored), texels + size.texels
                left = min(left, memory - largest - _MASKS * texels)
                if left < 0:
                    raise too_large(name, size)
        chunk = chunk_memory(len(self.document.coloured_vertices().colours), left) if self.vertices else None
        with arrays_in_files(
            left, Path(target).absolute().parent if target else None, in_chunks=chunk is not None
        ):
            yield chunk

    def layers(
        self, suffix: str | None = None, *, colours_only: bool = False, in_groups: bool = False
    ) -> Iterator[Layer]:
        """Yield the selected layers; `in_groups`: a layer for each group of textures that touch."""
        # Other parameters: see `ImageLayer`.
        document, settings = self.document, self.settings
        if self.image:
            from beltrami_cli.layers.image_layer import ImageLayer

            yield ImageLayer.read(document, settings, suffix=suffix, colours_only=colours_only)
        if self.vertices:
            yield layer_of_vertices(document, settings)
        counts = Counter(texture.key for surface in self.surfaces for texture in surface.textures)
        shared = frozenset(key for key, count in counts.items() if count > 1)
        for slot, surface in zip(self.slots, self.surfaces, strict=True):
            parts = (
                separate_surfaces(surface) if in_groups and settings.kernel.chooses_from_data else [surface]
            )
            for number, part in enumerate(parts, 1):
                name = f"part {number} of {len(parts)}" if len(parts) > 1 else ""
                yield TextureLayer.read(part, slot, settings, guided=document, shared=shared, group=name)

    def work(self) -> list[int]:
        """Estimate the work of each selected layer, in texels, without decoding an image."""
        counts = []
        if self.image:
            size = measure_image(self.document.data, self.document.name)
            counts.append(0 if size is None else size.texels)
        if self.vertices:
            counts.append(_TEXELS_OF_A_VERTEX * len(self.document.coloured_vertices().colours))
        return [*counts, *(int(covered_texels(surface).sum()) for surface in self.surfaces)]

    def require_geometry(self, *, is_patched: bool) -> None:
        """Raise errors if positions shall be smoothed, but are absent or cannot be stored."""
        document = self.document
        if not self.settings.embedding.smooth_geometry:
            return
        if not self.vertices:
            raise UsageError(
                "--smooth-geometry moves vertices along with their colours, but only textures are "
                "smoothed; choose --on vertices or --on both",
                document.name,
            )
        if document.grid() is not None or not len(document.coloured_vertices().faces):
            raise InputError(document.name, "it has no triangles, so there is no geometry to smooth")
        if is_patched:
            document.require_movable()

    def require_scale(self) -> list[str]:
        """Raise InputError if distances cannot be computed; return notices about coarsely rounded positions."""
        document, meshes = self.document, list[tuple[Float64s, Int32s]]()
        if self.vertices:
            vertices = document.coloured_vertices()
            meshes.append((vertices.positions, vertices.faces))
        for slot in self.slots:
            surface = document.textured(slot)
            meshes.append((surface.positions, surface.faces[surface.texture_of >= 0]))
        for mesh in meshes:
            require_scale(*mesh, document.name)
        return [*dict.fromkeys(notice for mesh in meshes for notice in coarse_rounding(*mesh))]


def select(document: Document, settings: SmoothSettings) -> Selection:
    """Select the parts by settings and document; errors if there are none, or for options that do not apply."""
    selection = _select(document, settings)
    # Options that do not apply to images, and the surface of images, are refused if given.
    given = binding_parameters(settings) if selection.image else given_parameters(settings.image)
    require_effect([*document.access.typed, *given], selection.kinds, document.name)
    return selection


def _select(document: Document, settings: SmoothSettings) -> Selection:
    if document.kind == "image":
        return Selection(document, settings, image=True)
    present = document.slots()
    slots = tuple(slot for slot in present if slot in settings.textures.slots)
    wanted = settings.textures.slots
    if not slots and settings.on != "vertices" and wanted and "baseColor" not in wanted:
        raise _no_such_textures(document, present, wanted)
    coloured = settings.on != "texture" and document.has_vertex_colours()
    if settings.on == "auto":
        slots = document.readable(slots)
    if settings.on == "vertices" or (settings.on == "auto" and not slots and coloured):
        if not coloured:
            document.coloured_vertices()  # raises an error that names what the file contains
        return Selection(document, settings, vertices=True)
    if settings.on == "both" and not (coloured and slots):
        missing = "vertex colours" if slots else "textures in the chosen slots"
        raise InputError(document.name, f"it has no {missing}", "use --on auto")
    if not slots:
        raise _no_colours_error(document, present, textures_only=settings.on == "texture")
    absent, both = absent_slots(document, settings), settings.on == "both"
    if coloured and not both:
        absent.append("its vertex colours stay as they are; --on both smooths them too")
    return _without_empty_slots(Selection(document, settings, both, slots, left_out=tuple(absent)))


def absent_slots(document: Document, settings: SmoothSettings) -> list[str]:
    """Return notices about slots that are named explicitly but have no textures."""
    wanted, present = settings.textures.slots, document.slots()
    return [] if wanted == SLOTS else [f"it has no {slot} textures" for slot in wanted if slot not in present]


def layer_of_vertices(document: Document, settings: SmoothSettings) -> VertexLayer:
    """Make the layer of a model's coloured vertices: on a mesh, as points, on a grid, or on a level set."""
    from beltrami_cli.layers.grid_layer import GridLayer
    from beltrami_cli.layers.guides import vertex_guides
    from beltrami_cli.layers.levelled_charts import photographs_of
    from beltrami_cli.layers.mesh_layer import MeshLayer
    from beltrami_cli.layers.sample_files import noise_of_vertices

    vertices, grid = document.coloured_vertices(), document.grid()
    guides = vertex_guides(document, settings)
    noise = noise_of_vertices(settings.kernel, document)
    if grid is None:
        photographs = partial(photographs_of, document)
        return MeshLayer(
            vertices=vertices, settings=settings, guides=guides, noise=noise, photographs_of=photographs
        )
    if wrong := [each.flag for each in binding_parameters(settings) if each.of == ("vertex colours",)]:
        cause = f"{', '.join(wrong)}: not on range images, whose vertices lie on a grid; leave it out"
        raise UsageError(cause)
    return GridLayer(vertices=vertices, grid=grid, settings=settings, guides=guides, noise=noise)


def _no_such_textures(document: Document, present: Sequence[Slot], wanted: Sequence[str]) -> InputError:
    if not present:
        return NoColoursError(document.name, "it has no textures", "leave out --slots")
    cause = f"it has no {' or '.join(wanted)} textures, only {', '.join(present)} textures"
    return NoColoursError(document.name, cause, f"give --slots {present[0]}")


def _no_colours_error(document: Document, present: Sequence[Slot], *, textures_only: bool) -> InputError:
    """Return the error that a document has no colours of the requested kind, or damaged ones."""
    why = Obstacle("")
    if textures_only and not present and document.has_vertex_colours():
        return NoColoursError(document.name, "it has no textures, only vertex colours", "use --on vertices")
    try:
        document.coloured_vertices()
    except NoColoursError as error:
        why = Obstacle(error.cause, error.remedy)
    except InputError as error:
        return error
    kinds = "no textures" if textures_only else "neither vertex colours nor textures"
    cause = f"it has {kinds} to smooth"
    if present:
        cause = f"{cause}, but textures in the slots {', '.join(present)}"
        return NoColoursError(document.name, cause, f"give --slots {present[0]}")
    if document.obstacles:
        why = Obstacle(document.obstacles[0].cause, document.obstacles[0].remedy or why.remedy)
    return NoColoursError(document.name, cause + (f" ({why.cause})" if why.cause else ""), why.remedy)


def _without_empty_slots(selection: Selection) -> Selection:
    """Remove slots without selected textures; UsageError if none is left."""
    document, wanted = selection.document, selection.settings.textures
    if not (wanted.names or wanted.materials):
        return selection
    pairs = zip(selection.slots, selection.surfaces, strict=True)
    kept = tuple(slot for slot, surface in pairs if surface.textures)
    if not kept:
        textures = [texture for slot in selection.slots for texture in document.textured(slot).textures]
        names = ", ".join(sorted({texture.name for texture in textures}))
        materials = ", ".join(sorted({name for texture in textures for name in texture.materials}))
        raise UsageError(
            f"no texture fits the globs; there are {names}"
            + (f", in the materials {materials}" if wanted.materials else ""),
            document.name,
        )
    return selection if kept == selection.slots else replace(selection, slots=kept)
