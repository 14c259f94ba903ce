"""`beltrami level` beside the stitching of TextureSignalProcessing: bench_stitching.py TOOL [MODEL ...]

TOOL is the program TextureStitching of https://github.com/mkazhdan/TextureSignalProcessing, built without its viewer.
Both get the same OBJ file with one texture whose charts have known exposures; the tool also gets a picture of the
charts as its mask. The table has by how many dB the error falls, up to one gain and offset for the whole model (in
brackets for each group of charts that seams without steps join), of the files that both write; and the seconds of
processor time of both. The last columns are the same texture as it was: the mean change, in steps of 255.
"""

import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from bench_levelling import SAMPLES
from measured_exposures import MeasuredScene
from scipy.ndimage import distance_transform_edt

from beltrami_cli.formats.image import read_image, write_image
from beltrami_cli.formats.image.picture import new_picture
from beltrami_cli.surface.grouping import group_places
from levelling.exposure_scene import fall

NAMES = ("head-tex-clean.glb", "head-tex-noisy.glb", "scan-clean.glb", "scan-noisy.glb")
# Of the colours as they are, for the tool: as it is set, and for corrections that reach further into charts.
WEIGHTS = ("100", "1")


def main(arguments):
    """Print a row for each model and way."""
    tool, models = arguments[0], arguments[1:] or [SAMPLES / name for name in NAMES]
    print(f"{'model':<26}{'':<26}{'plain':>14}{'clipped':>14}{'fall-off':>14}{'as it is':>11}{'s':>7}")
    for path in map(Path, models):
        scene = MeasuredScene.of(path)
        if len(scene.samples.pictures) != 1:
            print(f"{path.name:<26}has more than one texture")
            continue
        ways = {"beltrami level": _level}
        for weight in WEIGHTS:
            ways[f"TextureStitching, {weight}"] = lambda folder, weight=weight: _stitch(tool, folder, weight)
        for name, way in ways.items():
            _show(path.name, name, scene, way)


def _show(model, name, scene, way):
    groups, cells, spent = scene.joined(), [], 0.0
    for kind in ({}, {"clipped": True}, {"fall_off": True}):
        truth, exposed = scene.exposed(1, **kind)
        after, seconds = _run(scene, exposed, way)
        spent = max(spent, seconds)
        falls = (fall(exposed, after, truth, each) for each in (None, groups))
        cells.append("{:6.1f} ({:4.1f})".format(*falls))
    shown = np.rint(255 * scene.truth.clip(0, 1)) / 255
    same, _ = _run(scene, shown, way)
    change = 255 * np.abs(same - shown).mean()
    row = "".join(f"{cell:>14}" for cell in cells)
    print(f"{model:<26}{name:<26}{row}{change:11.2f}{spent:7.1f}", flush=True)


def _run(scene, colours, way):
    """Return the colours of the texels after a program worked on files of a model, and its processor time."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _write(scene, colours, folder)
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        picture = read_image(way(folder).read_bytes(), "result")
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    pixels = picture.pixels.reshape(-1, picture.pixels.shape[2])[:, :3]
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return pixels[scene.samples.atlas.owned_texels] / 255.0, spent


def _write(scene, colours, folder):
    """Write a model with these colours, and a picture in which each chart has a colour of its own."""
    atlas, surface = scene.samples.atlas, scene.samples.surface
    shape = scene.samples.pictures[0].pixels.shape[:2]
    charts = np.full(shape, -1)
    charts.reshape(-1)[atlas.owned_texels] = scene.charts
    image = np.zeros((*shape, 3))
    image.reshape(-1, 3)[atlas.owned_texels] = colours
    # What looks beyond a chart, by interpolation, finds its nearest colours.
    nearest = tuple(distance_transform_edt(charts < 0, return_distances=False, return_indices=True))
    numbers = 1 + charts[nearest]
    mask = np.stack([numbers % 250 + 1, numbers // 250 + 1, 0 * numbers + 1], axis=2)
    for name, each in (("texture", np.rint(255 * image[nearest])), ("mask", mask)):
        (folder / f"{name}.png").write_bytes(_png(each.astype(np.uint8)))
    (folder / "model.mtl").write_text("newmtl all\nmap_Kd texture.png\n")
    place_of, first = group_places(surface.positions, surface.space_of)
    textured = surface.texture_of >= 0
    faces, uv = place_of[surface.faces[textured]] + 1, surface.uv[textured]
    lines = ["mtllib model.mtl", "usemtl all"]
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in surface.positions[first].tolist()]
    corners, corner_of = np.unique(uv.reshape(-1, 2), axis=0, return_inverse=True)
    lines += [f"vt {u!r} {1 - v!r}" for u, v in corners.tolist()]
    corner_of = corner_of.reshape(-1, 3) + 1
    for places, own in zip(faces.tolist(), corner_of.tolist(), strict=True):
        lines.append("f " + " ".join(f"{place}/{corner}" for place, corner in zip(places, own, strict=True)))
    (folder / "model.obj").write_text("\n".join(lines) + "\n")


def _png(pixels):
    return write_image(new_picture(pixels, "texture"), pixels).data


def _level(folder):
    (folder / "out").mkdir()
    command = [sys.executable, "-m", "beltrami_cli", "level", "model.obj", "out/model.obj"]
    subprocess.run(command, cwd=folder, check=True, stderr=subprocess.DEVNULL)
    return next((folder / "out").glob("*.png"))


def _stitch(tool, folder, weight):
    command = [Path(tool).resolve(), "--in", "model.obj", "texture.png", "--mask", "mask.png", "--out", "out.png",
               "--interpolation", weight]  # fmt: skip
    subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return folder / "out.png"


if __name__ == "__main__":
    main(sys.argv[1:])
