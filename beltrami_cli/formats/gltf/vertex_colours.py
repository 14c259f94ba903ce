"""The coloured primitives of a glTF file as blocks of rows.

A mesh is taken at the first node that shows it. A block is one pair of positions and colours. Primitives that use the
same pair (the same accessors, or accessors over the same bytes) share its rows, so that every stored colour has
exactly one row.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int32s
from beltrami_cli.errors import NoColoursError
from beltrami_cli.formats.gltf.accessors import MAX_ROWS, Accessor, Stored, fractions
from beltrami_cli.formats.gltf.nodes import Placement
from beltrami_cli.formats.gltf.primitives import Meshes, Primitive
from beltrami_cli.surface.records import ColouredVertices

_COLOUR_TYPES = ("uint8", "uint16", "float32")  # component types of COLOR_0, the coarsest first
_NAMED_SEPARATELY = ("POSITION", "COLOR_0", "NORMAL")  # not among the attributes by name
_INDICES = ("JOINTS_", "WEIGHTS_")


@dataclass
class Block:
    """The rows of one pair of accessors, from `first_row` on."""

    # By attribute: positions, colours, and normals if the first primitive has any.
    accessors: dict[str, Accessor]
    placement: Placement  # of the mesh that uses the pair first
    first_row: int
    count: int
    # The primitives that name these colours, by mesh and index in the mesh.
    users: dict[tuple[int, int], Primitive] = field(default_factory=dict)

    @property
    def first_user(self) -> Primitive:
        return next(iter(self.users.values()))

    @property
    def rows(self) -> slice:
        return slice(self.first_row, self.first_row + self.count)


class ColouredBlocks:
    """All blocks and their triangles: of primitives that have COLOR_0, in file order."""

    def __init__(self, name: str, meshes: Meshes, places: Sequence[Placement]) -> None:
        self.blocks: list[Block] = []
        self._block_of: dict[Hashable, Block] = {}
        self._faces: dict[Hashable, Int32s] = {}
        self._rows = 0
        self._counts = dict.fromkeys(("uncoloured", "elsewhere", "instanced", "morphed", "plain"), 0)
        for number, (mesh, placement) in enumerate(zip(meshes, places, strict=True)):
            for part, primitive in enumerate(mesh):
                self._take(primitive, placement, (number, part))
        if not self.blocks:
            remedy = "give its vertices colours first"
            raise NoColoursError(name, "the model has no vertex colours (COLOR_0)", remedy)

    def _take(self, primitive: Primitive, placement: Placement, number: tuple[int, int]) -> None:
        if "COLOR_0" not in primitive:
            self._counts["uncoloured"] += 1
            return
        targets = primitive.entry.entries("targets")
        self._counts["morphed"] += any("COLOR_0" in target for target in targets)
        block = self._block(primitive, placement, number)
        if block is None:
            return
        key = block.first_row, primitive.drawing_key()
        if key not in self._faces:
            faces = placement.facing(primitive.triangles(block.count))
            self._faces[key] = (faces + block.first_row).astype(np.int32)

    def _block(self, primitive: Primitive, placement: Placement, number: tuple[int, int]) -> Block | None:
        """Return the block of a primitive; None if its colours already have rows at other positions."""
        position, colour = primitive.position(), self._colour(primitive)
        count = colour.count
        if position.count != count:
            cause = f"has {count} elements, but POSITION has {position.count}"
            raise primitive.attributes.fault("COLOR_0", cause)
        key = colour.identity
        if key not in self._block_of:
            named = {"POSITION": position, "COLOR_0": colour}
            if "NORMAL" in primitive:
                named["NORMAL"] = primitive.fitting("NORMAL", "VEC3", count)
            block = self._block_of[key] = Block(named, placement, self._rows, count)
            self.blocks.append(block)
            self._rows += count
            if self._rows > MAX_ROWS:
                raise primitive.attributes.fault("COLOR_0", f"more than {MAX_ROWS} colours in one model")
            self._counts["instanced"] += placement.nodes > 1
        block = self._block_of[key]
        block.users[number] = primitive
        if block.accessors["POSITION"].identity != position.identity:
            self._counts["elsewhere"] += 1
            return None
        if block.placement is not placement:
            same = np.array_equal(block.placement.matrix, placement.matrix)
            self._counts["instanced"] += not same or block.placement.space != placement.space
        return block

    def _colour(self, primitive: Primitive) -> Accessor:
        accessor = primitive.accessor("COLOR_0")
        if accessor.shape not in ("VEC3", "VEC4") or accessor.component.name not in _COLOUR_TYPES:
            cause = f"is {accessor.shape} of {accessor.component.name}, not a colour"
            raise primitive.attributes.fault("COLOR_0", cause)
        self._counts["plain"] += accessor.component.kind == "u" and not accessor.normalised
        return accessor

    def _notices(self) -> tuple[str, ...]:
        sentences = {
            "uncoloured": "{} primitive(s) without COLOR_0 are left as they are.",
            "elsewhere": "{} primitive(s) reuse colours with other positions; the colours are smoothed where "
            "they occur first.",
            "instanced": "{} coloured part(s) are shown by several nodes; each is smoothed once, at its first place.",
            "morphed": "{} primitive(s) have morph targets of COLOR_0, which are left as they are.",
            "plain": "{} primitive(s) store integer colours that are not marked as normalised; they are read as if "
            "they were.",
        }
        return tuple(sentence.format(n) for key, sentence in sentences.items() if (n := self._counts[key]))

    @cached_property
    def stored_colours(self) -> list[Stored]:
        """Colours of every block as stored, each of shape (rows of the block, 3 or 4)."""
        return [block.accessors["COLOR_0"].finite("colour") for block in self.blocks]

    def vertices(self) -> ColouredVertices:
        """Return the rows of all blocks."""
        spaces = np.concatenate([np.full(each.count, each.placement.space, np.int32) for each in self.blocks])
        places = [block.placement.positions(block.accessors["POSITION"]) for block in self.blocks]
        types = {numbers.dtype.name for numbers in self.stored_colours}
        return ColouredVertices(
            positions=np.concatenate(places),
            faces=np.concatenate([np.empty((0, 3), np.int32), *self._faces.values()]),
            colours=np.concatenate([fractions(numbers[:, :3]) for numbers in self.stored_colours]),
            channels=("red", "green", "blue"),
            encoding="linear",
            stored=next(kind for kind in _COLOUR_TYPES if kind in types),
            space_of=spaces if np.any(spaces != spaces[0]) else None,
            notices=self._notices(),
        )

    def opacity(self) -> Float32s | None:
        """Return the opacity of all rows in [0, 1], None if no block has any."""
        if all(numbers.shape[1] == 3 for numbers in self.stored_colours):
            return None
        opaque = np.ones(self._rows, np.float32)
        for block, numbers in zip(self.blocks, self.stored_colours, strict=True):
            if numbers.shape[1] == 4:
                opaque[block.rows] = np.clip(fractions(numbers[:, 3]), 0, 1)
        return opaque

    def by_primitive(self, colours: Float32s) -> dict[tuple[int, int], Float32s]:
        """Return colours (V, 3), with opacity if there is any, of each primitive by mesh and index in the mesh."""
        alpha = self.opacity()
        rows = colours if alpha is None else np.column_stack([colours, alpha])
        return {user: rows[block.rows] for block in self.blocks for user in block.users}

    def normals(self) -> Float32s | None:
        """Return unit normals in world space if every block has them; zero vectors stay zero."""
        if any("NORMAL" not in block.accessors for block in self.blocks):
            return None
        parts = [block.placement.normals(block.accessors["NORMAL"]) for block in self.blocks]
        return np.concatenate(parts).astype(np.float32)

    def attribute_names(self) -> tuple[str, ...]:
        """Return the attributes that all blocks have; "normal" for their normals."""
        held = [set(block.first_user.attributes.value) for block in self.blocks]
        common = set.intersection(*held)
        names = sorted(
            name for name in common if name not in _NAMED_SEPARATELY and not name.startswith(_INDICES)
        )
        return (*(("normal",) if "NORMAL" in common else ()), *names)

    def attribute(self, name: str) -> Float64s:
        """Read an attribute of all blocks, shape (V, G)."""
        parts: list[Float64s] = []
        for block in self.blocks:
            values = block.first_user.accessor(name).values()
            if len(values) != block.count or (parts and values.shape[1] != parts[0].shape[1]):
                cause = (
                    f"is {len(values)} x {values.shape[1]} numbers, which do not fit {block.count} vertices"
                )
                if parts and len(values) == block.count:
                    cause += f" of {parts[0].shape[1]} numbers elsewhere"
                raise block.first_user.attributes.fault(name, cause)
            parts.append(values)
        return np.concatenate(parts)
