"""The painted primitives of a glTF file, in blocks of rows: what their vertices have, and new numbers for them.

A block is one pair of positions and colours. Primitives that use the same pair (the same accessors, or
accessors over the same bytes) share its rows, so that every stored colour has exactly one row.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s, Int32s
from beltrami_cli.errors import UnpaintedError
from beltrami_cli.formats.colours import quantised
from beltrami_cli.formats.gltf import geometry
from beltrami_cli.formats.gltf.accessors import Accessors, Stored, fractions
from beltrami_cli.formats.gltf.columns import Column, exchange
from beltrami_cli.formats.gltf.edit import Edit
from beltrami_cli.formats.gltf.json_tree import Entry
from beltrami_cli.surface.geometry import unit_vectors
from beltrami_cli.surface.records import MovedVertices, PaintedVertices

_COLOUR_TYPES = ("uint8", "uint16", "float32")  # component types of COLOR_0, the coarsest first
_MOST_ROWS = np.iinfo(np.int32).max
_OTHERWISE = ("POSITION", "COLOR_0", "NORMAL")  # not among the attributes by name
_INDICES = ("JOINTS_", "WEIGHTS_")


@dataclass
class Block:
    """The rows of one pair of accessors, from `first_row` on."""

    position: int
    colour: int
    placement: geometry.Placement  # of the mesh that uses the pair first
    first_row: int
    count: int
    normal: int | None  # accessor of the normals of the first primitive
    # Accessors over these colours that primitives name as COLOR_0, and those primitives: mesh, and index in the mesh.
    members: set[int] = field(default_factory=set)
    users: list[tuple[int, int]] = field(default_factory=list)

    @property
    def rows(self) -> slice:
        return slice(self.first_row, self.first_row + self.count)


class Surface:
    """All blocks and their triangles: of primitives that have COLOR_0, in file order."""

    def __init__(self, root: Entry, accessors: Accessors, places: Sequence[geometry.Placement]) -> None:
        self.accessors = accessors
        self.blocks: list[Block] = []
        self._block_of: dict[Hashable, Block] = {}
        self._faces: dict[Hashable, Int32s] = {}
        self._rows = 0
        self._counts = dict.fromkeys(("uncoloured", "elsewhere", "instanced", "morphed", "plain"), 0)
        for number, (mesh, placement) in enumerate(zip(root.entries("meshes"), places, strict=True)):
            for part, primitive in enumerate(mesh.entries("primitives")):
                self._take(primitive, placement, (number, part))
        if not self.blocks:
            remedy = "paint the vertices first, or bake the texture into them"
            raise UnpaintedError(root.name, "the model has no vertex colours (COLOR_0)", remedy)

    def _take(self, primitive: Entry, placement: geometry.Placement, number: tuple[int, int]) -> None:
        if "COLOR_0" not in primitive.entry("attributes"):
            self._counts["uncoloured"] += 1
            return
        self._counts["morphed"] += any("COLOR_0" in target for target in primitive.entries("targets"))
        block = self._block(primitive, placement, number)
        if block is None:
            return
        key = block.first_row, geometry.drawing(primitive, self.accessors)
        if key not in self._faces:
            faces = geometry.drawn(primitive, self.accessors, block.count, placement)
            self._faces[key] = (faces + block.first_row).astype(np.int32)

    def _block(
        self, primitive: Entry, placement: geometry.Placement, number: tuple[int, int]
    ) -> Block | None:
        """Return the block of a primitive; None if its colours already have rows at other positions."""
        attributes = primitive.entry("attributes")
        position, colour = geometry.position_accessor(primitive, self.accessors), self._colour(primitive)
        count = self.accessors[colour].count
        if self.accessors[position].count != count:
            cause = f"has {count} elements, but POSITION has {self.accessors[position].count}"
            raise attributes.fault("COLOR_0", cause)
        key, place = self.accessors.identity(colour), self.accessors.identity(position)
        if key not in self._block_of:
            normal = None
            if "NORMAL" in attributes:
                normal = geometry.fitting_accessor(primitive, "NORMAL", self.accessors, "VEC3", count)
            block = Block(position, colour, placement, self._rows, count, normal)
            self._block_of[key] = block
            self.blocks.append(block)
            self._rows += count
            if self._rows > _MOST_ROWS:
                raise attributes.fault("COLOR_0", f"more than {_MOST_ROWS} colours in one model")
            self._counts["instanced"] += placement.nodes > 1
        block = self._block_of[key]
        block.members.add(colour)
        block.users.append(number)
        if self.accessors.identity(block.position) != place:
            self._counts["elsewhere"] += 1
            return None
        if block.placement is not placement:
            same = np.array_equal(block.placement.matrix, placement.matrix)
            self._counts["instanced"] += not same or block.placement.space != placement.space
        return block

    def _colour(self, primitive: Entry) -> int:
        index = geometry.attribute_accessor(primitive, "COLOR_0", self.accessors)
        accessor = self.accessors[index]
        if accessor.shape not in ("VEC3", "VEC4") or accessor.component.name not in _COLOUR_TYPES:
            cause = f"is {accessor.shape} of {accessor.component.name}, not a colour"
            raise primitive.entry("attributes").fault("COLOR_0", cause)
        self._counts["plain"] += accessor.component.kind == "u" and not accessor.normalised
        return index

    @property
    def faces(self) -> Int32s:
        return np.concatenate([np.empty((0, 3), np.int32), *self._faces.values()])

    def notices(self) -> list[str]:
        """Return what the user should know about what was left out."""
        sentences = {
            "uncoloured": "{} primitive(s) without COLOR_0 are left as they are.",
            "elsewhere": "{} primitive(s) reuse colours with other positions; the colours are smoothed where "
            "they occur first.",
            "instanced": "{} painted part(s) are shown by several nodes; each is smoothed once, at its first place.",
            "morphed": "{} primitive(s) have morph targets of COLOR_0, which are left as they are.",
            "plain": "{} primitive(s) store integer colours that are not marked as normalised; they are read as if "
            "they were.",
        }
        return [sentence.format(n) for key, sentence in sentences.items() if (n := self._counts[key])]


def painted_vertices(surface: Surface, accessors: Accessors, colours: Sequence[Stored]) -> PaintedVertices:
    """Return the rows of all blocks; `colours` are those of each block as stored."""
    blocks = surface.blocks
    types = {numbers.dtype.name for numbers in colours}
    spaces = np.concatenate([np.full(block.count, block.placement.space, np.int32) for block in blocks])
    fraction = np.concatenate([fractions(numbers[:, :3]) for numbers in colours])
    places = [(block.position, block.placement) for block in blocks]
    positions = [geometry.in_world(placement, accessors, index) for index, placement in places]
    return PaintedVertices(
        positions=np.concatenate(positions),
        faces=surface.faces,
        colours=fraction,
        channels=("red", "green", "blue"),
        encoding="linear",
        stored=next(kind for kind in _COLOUR_TYPES if kind in types),
        space_of=spaces if np.any(spaces != spaces[0]) else None,
    )


def normals_of(blocks: Sequence[Block], accessors: Accessors) -> Float32s | None:
    """Return unit normals in world space if every block has them; those of length zero stay zero."""
    parts = []
    for block in blocks:
        if block.normal is None:
            return None
        parts.append(geometry.turned(accessors.values(block.normal), block.placement.matrix))
    return np.concatenate(parts).astype(np.float32)


def attribute_names(root: Entry, blocks: Sequence[Block]) -> tuple[str, ...]:
    """Return the attributes that all blocks have; "normal" for their normals."""
    held = [set(_first_user(root, block).entry("attributes").value) for block in blocks]
    common = set.intersection(*held) if held else set()
    others = sorted(name for name in common if name not in _OTHERWISE and not name.startswith(_INDICES))
    return (*(("normal",) if "NORMAL" in common else ()), *others)


def read_attribute(root: Entry, blocks: Sequence[Block], accessors: Accessors, name: str) -> Float64s:
    """Read an attribute of all blocks, shape (V, G)."""
    parts: list[Float64s] = []
    for block in blocks:
        primitive = _first_user(root, block)
        values = accessors.values(geometry.attribute_accessor(primitive, name, accessors))
        if len(values) != block.count or (parts and values.shape[1] != parts[0].shape[1]):
            cause = f"is {len(values)} x {values.shape[1]} numbers, which do not fit {block.count} vertices"
            if parts and len(values) == block.count:
                cause += f" of {parts[0].shape[1]} numbers elsewhere"
            raise primitive.entry("attributes").fault(name, cause)
        parts.append(values)
    return np.concatenate(parts)


def _first_user(root: Entry, block: Block) -> Entry:
    mesh, part = block.users[0]
    return root.entries("meshes")[mesh].entries("primitives")[part]


_STALE = "The vertices moved, but their {} are as they were; make them anew, or leave them out."


def recolour(
    edit: Edit, blocks: Sequence[Block], stored: Sequence[Stored], old: Float32s, new: Float32s
) -> None:
    """Put new colours (V, 3) into a file; `stored` are those of each block, and only entries that differ change."""
    if new.shape != old.shape or not np.isfinite(new).all():
        raise ValueError(f"colours must be finite and of shape {old.shape}, not {new.shape}")
    columns, numbers = [], []
    for block, before in zip(blocks, stored, strict=True):
        after = before.copy()
        differs = new[block.rows] != old[block.rows]
        after[:, :3][differs] = quantised(new[block.rows][differs], before.dtype)
        columns.append(Column("COLOR_0", block.colour, block.members, block.users, block.position))
        numbers.append((before, after))
    exchange(edit, columns, numbers)


def require_movable(accessors: Accessors, blocks: Sequence[Block]) -> None:
    """Check that positions can be replaced: floats, not compressed by Draco, and not scaled to nothing."""
    for block in blocks:
        accessor = accessors[block.position]
        if accessors.is_added(block.position):
            remedy = "decompress the model first with a glTF optimiser"
            raise accessor.entry.fault("", "Draco positions cannot be replaced", remedy)
        if accessor.component.kind != "f":
            cause = f"positions are {accessor.component.name} (KHR_mesh_quantization), which cannot hold smoothed ones"
            raise accessor.entry.fault("componentType", cause, "store them as floats, with a glTF optimiser")
        if abs(np.linalg.det(block.placement.matrix[:3, :3])) < np.finfo(np.float64).tiny:
            raise accessor.entry.fault("", "its node scales the positions to nothing")


def move(edit: Edit, blocks: Sequence[Block], old: Float64s, places: MovedVertices) -> None:
    """Put new positions, and normals if there are any, into a file; only rows that differ from `old` are written."""
    held = [(block, block.position) for block in blocks]
    _exchange_shared(edit, "POSITION", held, places.positions - old, _moved)
    normals, stale = places.normals, set()
    if normals is not None:
        held = [(block, block.normal) for block in blocks if block.normal is not None]
        _exchange_shared(edit, "NORMAL", held, normals, _turned)
    elif any(block.normal is not None for block in blocks):
        stale.add("normals")
    meshes = edit.container.root.entries("meshes")
    for mesh, part in (user for block in blocks for user in block.users):
        if "TANGENT" in meshes[mesh].entries("primitives")[part].entry("attributes"):
            stale.add("tangents")
    edit.notices += [_STALE.format(what) for what in sorted(stale)]


def _moved(block: Block, before: Stored, moves: Array) -> Stored:
    rows = moves.any(axis=1)
    back = np.linalg.inv(block.placement.matrix[:3, :3]).T
    after = before.copy()
    after[rows] = (before[rows].astype(np.float64) + moves[rows] @ back).astype(before.dtype)
    return after


def _turned(block: Block, before: Stored, normals: Array) -> Stored:
    rows = ~np.isnan(normals).any(axis=1)
    # Normals went to the common space by the inverse transpose.
    local = unit_vectors(normals[rows].astype(np.float64) @ block.placement.matrix[:3, :3])
    after = before.copy()
    after[rows] = local if before.dtype.kind == "f" else np.rint(local * np.iinfo(before.dtype).max)
    return after


def _exchange_shared(
    edit: Edit,
    attribute: str,
    held: Sequence[tuple[Block, int]],
    rows: Array,
    renew: Callable[[Block, Stored, Array], Stored],
) -> None:
    """Exchange an attribute of all blocks, which may share its numbers; it is renewed by what is new of their rows."""
    accessors = edit.accessors
    # By primitives, painted or not.
    named = {
        primitive.entry("attributes").integer(attribute, below=len(accessors.all))
        for mesh in edit.container.root.entries("meshes")
        for primitive in mesh.entries("primitives")
        if attribute in primitive.entry("attributes")
    }
    columns: dict[Hashable, tuple[Column, Stored, Stored]] = {}
    for block, index in held:
        before = accessors.stored(index)
        after, key = renew(block, before, rows[block.rows]), accessors.identity(index)
        if key not in columns:
            same = {other for other in named if accessors.identity(other) == key}
            columns[key] = Column(attribute, index, same, block.users, block.position), before, after
            continue
        _, _, earlier = columns[key]
        mine, theirs = (after != before).any(axis=1), (earlier != before).any(axis=1)
        if attribute == "POSITION" and not np.array_equal(after[mine | theirs], earlier[mine | theirs]):
            cause = "is shared by parts that would move apart"
            raise accessors[index].entry.fault("", cause, "give each part positions of its own")
        earlier[mine] = after[mine]
    found = list(columns.values())
    exchange(edit, [column for column, _, _ in found], [(before, after) for _, before, after in found])
