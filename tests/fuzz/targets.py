"""What is fuzzed: for every reader a function of bytes that must do nothing worse than refuse them in one line.

What is read is also written with other colours and read again: then colours must be all that differs.
"""

import contextlib
import os
import tempfile
from pathlib import Path

import click
import numpy as np

from beltrami_cli import smooth
from beltrami_cli.batch.item import Item
from beltrami_cli.batch.plan import plan
from beltrami_cli.batch.record import is_done, is_own_output, read_outcomes
from beltrami_cli.cli.batch_items import item_with
from beltrami_cli.cli.commands.batch import batch
from beltrami_cli.cli.configuration import configured_values, load
from beltrami_cli.errors import BeltramiError, InputError, UsageError
from beltrami_cli.formats.changes import Naming
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.image.writing import write_image
from beltrami_cli.formats.output_format import image_suffixes, sidecars_of_mesh, write_mesh
from beltrami_cli.formats.registry import FORMATS, open_bytes
from beltrami_cli.formats.sidecars.model_folder import ModelFolder
from beltrami_cli.formats.usd.package import Package
from beltrami_cli.formats.volume import is_volume, read_volume
from beltrami_cli.layers.settings import DEFAULTS
from beltrami_cli.surface.records import ImageFile
from beltrami_cli.view.report import read_parameters

SEPARATOR = b"\n=== "
"""Between the files of a model: behind it stands the name of the next one, up to the end of the line."""

ACCESS = Access(memory=1 << 28)
MAX_SAMPLES = 1 << 20
TEXTURED = [line for line in FORMATS if line.has_textures]
_MAX_KERNEL = 300  # vertices, so that a run takes milliseconds
_SCRATCH = "/dev/shm" if Path("/dev/shm").is_dir() else None  # so that files never reach a disk


def read_model(data, name):
    """Read a model with the files beside it, use every road through it, write it and compare."""
    main, *others = data.split(SEPARATOR)
    with tempfile.TemporaryDirectory(dir=_SCRATCH) as folder:
        for other in others[:4]:
            path, _, content = other.partition(b"\n")
            _write(Path(folder), os.fsdecode(path), content)
        document = open_bytes(main, name, Path(folder), ACCESS)
        document.facts()
        document.references()
        uses = (document.fingerprint, document.contents, lambda: _use_vertices(document, Path(folder)))
        for use in (*uses, lambda: _convert(document)):
            with contextlib.suppress(InputError):
                use()
        for slot in document.slots()[:2]:
            with contextlib.suppress(InputError):
                surface = document.textured(slot)
                assert np.isfinite(surface.uv[surface.texture_of >= 0]).all()
                images = {(slot, texture.key): ImageFile(b"new", ".png") for texture in surface.textures}
                _compare(
                    document, document.patch(None, Naming("out", in_place=True), images=images), Path(folder)
                )


def _use_vertices(document, folder):
    vertices = document.coloured_vertices()
    assert np.isfinite(vertices.colours).all()
    assert vertices.faces.size == 0 or 0 <= vertices.faces.min() <= vertices.faces.max() < len(
        vertices.colours
    )
    if len(vertices.faces):  # points may lack places that were not measured
        assert np.isfinite(vertices.positions[vertices.faces]).all()
    for name in document.attributes()[:3]:
        with contextlib.suppress(InputError):
            document.attribute(name)
    # What numbers mean that can mean two things may look otherwise in the result; the user sees a notice.
    doubtful = any("taken for" in notice for notice in vertices.notices)
    if any(document.format == line.name for line in TEXTURED) and not doubtful:
        colours = np.clip(vertices.colours * np.float32(0.5), 0, 1)
        _compare(document, document.patch(colours, Naming("out", in_place=True)), folder)


def _convert(document):
    """Write a glTF file in its other form, and a textured model in the formats that have textures."""
    if document.format == "gltf":
        document.patch(None, Naming("out"), form="glb")
    if document.slots():
        mesh = document.textured_mesh()
        for form in (line.name for line in TEXTURED if line.reader != "usd"):  # which is slow to write
            held, names = image_suffixes(form), sidecars_of_mesh(mesh, form, "out")
            assert held is not None
            assert len({*names}) == len(names)
            if not held or all(image.file.suffix in held for image in mesh.images):
                # Of an image that only polygons without coordinates have, glTF holds nothing.
                assert {*write_mesh(mesh, form, "out").sidecars} <= {*names}


def _compare(before, written, folder):
    """Check that files as written are what was read, but for colours and images."""
    with tempfile.TemporaryDirectory(dir=folder) as other:
        for path in before.references():
            _write(Path(other), path, (folder / path).read_bytes())
        for path, data in written.sidecars.items():
            _write(Path(other), path, bytes(data))
        after = open_bytes(b"".join(written.main), before.name, Path(other), ACCESS)
        old, new = before.fingerprint().parts, after.fingerprint().parts
        changed = [part for part in {**old, **new} if old.get(part) != new.get(part)]
        assert not changed, f"written anew, {changed} differ"


def _write(folder, name, content):
    path = folder / name
    with contextlib.suppress(OSError, ValueError):
        if path.resolve().is_relative_to(folder.resolve()):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)


def read_package(data):
    """Read a USDZ package as far as this program does: its files, and itself written anew."""
    package = Package(data, "x.usdz", ACCESS)
    names = [name for name in package.members if name not in package.layers]
    files = {name: package.read(name) for name in package.members}
    assert Package(b"".join(package.packed({})), "x.usdz", ACCESS).members == package.members
    again = Package(b"".join(package.packed(dict.fromkeys(names[:1], b"new"))), "x.usdz", ACCESS)
    for name in package.members:
        assert again.read(name) == (b"new" if name in names[:1] else files[name])


def read_picture(data):
    """Read an image, and write it as it was."""
    suffixes = (".png", ".tga", ".exr", ".hdr", ".rla")
    picture = read_image(data[1:], "x" + suffixes[data[0] % len(suffixes)] if data else "x")
    assert np.isfinite(picture.pixels).all()
    if picture.pixels.size < MAX_SAMPLES:
        write_image(picture, picture.pixels)


def read_grid(data):
    """Read a volume."""
    if is_volume(data, "x.nrrd"):
        read_volume(data, "x.nrrd", ModelFolder(None), MAX_SAMPLES)


def smooth_arrays(data):
    """Make a mesh and colours of any kind, and smooth it: colours stay within their range, and holes as they are."""
    head, rest = np.frombuffer(data[:8].ljust(8, b"\0"), np.uint8), data[8:]
    numbers = np.frombuffer(rest[: len(rest) // 8 * 8], np.float64)[: 6 * _MAX_KERNEL]
    vertices = len(numbers) // 6
    positions, colours = (
        numbers[: 3 * vertices].reshape(-1, 3),
        numbers[3 * vertices : 6 * vertices].reshape(-1, 3),
    )
    corners = np.frombuffer(rest[::-1][: 3 * _MAX_KERNEL], np.uint8).astype(np.int64)
    faces = corners[: len(corners) // 3 * 3].reshape(-1, 3) % max(1, vertices)
    options = {
        "iterations": int(head[0] % 3), "t": float(head[1]) / 32, "beta": None if head[2] < 64 else float(head[2]),
        "metric_scale": float(head[3] % 4), "metric_steps": int(head[4] % 3), "threads": 1 + int(head[5] % 2),
        "weights": ("uniform", "area")[head[6] % 2], "clipping": ("restore", "keep")[head[7] % 2],
    }  # fmt: skip
    with np.errstate(invalid="ignore"):
        colours = np.abs(colours) % 1 if head[6] & 2 else colours
        positions = positions % 8 if head[6] & 4 else positions
    result = smooth(positions, None if head[6] & 8 else faces, colours, **options).colours
    is_hole = ~np.isfinite(colours).all(axis=1)
    assert np.isfinite(result[~is_hole]).all()
    assert np.array_equal(result[is_hole], colours[is_hole], equal_nan=True)
    if options["clipping"] == "keep" and not is_hole.all():
        colours, result = colours[~is_hole].astype(np.float32), result[~is_hole]
        low, high = colours.min(axis=0), colours.max(axis=0)
        slack = 1e-5 * np.maximum(1, np.maximum(np.abs(low), np.abs(high)))
        assert (result >= low - slack).all()
        assert (result <= high + slack).all()


@contextlib.contextmanager
def _written(name, data):
    """Write a file that is read as data, next to a model that manifests can name."""
    with tempfile.TemporaryDirectory(dir=_SCRATCH) as folder:
        (Path(folder) / "a.ply").write_bytes(b"")
        (Path(folder) / name).write_bytes(data)
        yield Path(folder) / name


def read_configuration(data):
    """Read a configuration that is named, and what it says for two commands."""
    with _written("pyproject.toml" if data[:1] == b"\1" else "beltrami.toml", data) as path:
        configuration = load(str(path))
        for command in ("smooth", "batch"):
            configured_values(configuration, command)


def read_manifest(data):
    """Read a manifest, whose kind the first byte says, and the parameters for each file."""
    with _written("x" + (".toml", ".csv", ".jsonl")[data[0] % 3 if data else 1], data[1:]) as path:
        for request in plan([str(path)], str(path.parent / "out"), "", None):
            assert Path(request.target).is_relative_to(path.parent / "out")
            # What the command puts behind the line's name.
            with (
                contextlib.suppress(click.UsageError, UsageError, ValueError),
                batch.make_context("batch", ["a.ply", "--out-dir", "out"]).scope() as context,
            ):
                item_with(request, context.params, ())


def read_record(data):
    """Read a record, and see whether it says that files are done, or may be replaced."""
    with _written("batch.jsonl", data) as path:
        item = Item(str(path.with_name("a.ply")), str(path.with_name("b.ply")), DEFAULTS)
        for outcome in read_outcomes(str(path)).values():
            assert not is_done(item, outcome)
            is_own_output(outcome)


def read_report(data):
    """Read the report of a run as a page shows it."""
    with _written("run.json", data) as path:
        assert "<script" not in read_parameters(str(path), Access())


def named(name):
    """Return a reader of models of some name."""
    return lambda data: read_model(data, name)


TARGETS = {
    "ply": named("x.ply"),
    "obj": named("x.obj"),
    "gltf": named("x.gltf"),
    "off": named("x.off"),
    "stl": named("x.stl"),
    "3mf": named("x.3mf"),
    "usd": named("x.usda"),  # in a process of its own, so slowly
    "usdz": read_package,
    "xyz": named("x.xyz"),
    "npz": named("x.npz"),
    "image": read_picture,
    "volume": read_grid,
    "arrays": smooth_arrays,
    "configuration": read_configuration,
    "manifest": read_manifest,
    "record": read_record,
    "report": read_report,
}
"""All targets by name; the seeds of each are in the folder `corpus` under its name."""


def attempt(target, data):
    """Give bytes to a target; whatever is raised is a finding, but for our own errors in one line."""
    try:
        TARGETS[target](data)
    except BeltramiError as error:
        refusal = error
    else:
        return
    assert isinstance(refusal, (InputError, UsageError)) or target in ("image", "arrays"), repr(refusal)
    assert "\n" not in str(refusal)
