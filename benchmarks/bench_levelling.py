"""How far `beltrami level` brings charts of known exposure back: python benchmarks/bench_levelling.py [MODEL ...]

Each chart gets a gain and an offset in each channel; then with colours that are cut off; then with a gain that falls
off linearly over each chart. The table has by how many dB the error falls, up to one gain and offset for the whole
model, and in brackets up to one for the charts that hang together by seams without steps: others have no common
exposure. Of colours that are cut off, the fall for who knows the exposures of all charts follows behind a slash. The
last columns are the change of the model as it is, and the seconds of processor time of the fit.

With --told, the table has what levelling reaches if it is told which stretches of seams are painted, and behind a slash
what it reaches if there is neither paint nor noise at seams: what the best choice of stretches, and seams at all, give.

With --spaces, each chart and channel gets a gain of linear light, of 0.6 to 1.6. The table has by how many dB the error
of display values falls, up to a gain and offset for each group of charts, if levelled in display values, in light, and
in its logarithm.

With --jpeg, the exposed textures are stored as JPEG with colour at half the resolution, of three qualities. The table
has by how many dB the error falls if levelling is not told of that, behind an arrow if it is, and behind a slash for
who knows the exposures.

With --large, the whole command works on a torus in 3,136 charts of one texture of 4096 x 4096.
"""

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from measured_exposures import MeasuredScene
from scene import ROOT

from beltrami_cli.formats.image import write_image
from beltrami_cli.formats.image.picture import new_picture
from levelling.exposure_scene import GAINS, OFFSET, fall, from_light, to_light

SAMPLES = ROOT / "sample_data"
NAMES = ("head-tex-clean.glb", "head-tex-noisy.glb", "torus-two-clean.gltf", "sphere-exr-clean.obj", "scan-clean.glb",
         "scan-noisy.glb")  # fmt: skip
KINDS = ({}, {"clipped": True}, {"fall_off": True})


def measured(scene, seed, kind, groups):
    """Return the fall of the error for all and for groups, for who knows the exposures, and the seconds it took."""
    truth, exposed = scene.exposed(seed, **kind)
    start = time.process_time()
    after = scene.levelled(exposed)[0].clip(0, 1)
    spent = time.process_time() - start
    known = fall(exposed, scene.restored(seed, **kind), truth)
    return fall(exposed, after, truth), fall(exposed, after, truth, groups), known, spent


# Spaces of colours for a fit, as functions from linear light to 0 to 1, and back. The logarithm begins at black.
BLACK = 1 / 255
SPACES = {
    "display": (from_light, to_light),
    "light": (np.asarray, np.asarray),
    "log": (
        lambda light: np.log1p(light / BLACK) / np.log1p(1 / BLACK),
        lambda shown: BLACK * np.expm1(shown * np.log1p(1 / BLACK)),
    ),
}


def compare_spaces(models):
    """Print a row for each model."""
    print(f"{'model':<26}" + "".join(f"{name:>9}" for name in SPACES))
    for path in models:
        scene = MeasuredScene.of(path)
        groups, falls = scene.joined(), []
        for seed in (1, 2):
            truth, exposed = scene.exposed(seed, in_light=True)
            falls.append([])
            for there, back in SPACES.values():
                after = back(scene.levelled(there(to_light(exposed)))[0].clip(0, 1))
                falls[-1].append(fall(exposed, from_light(after), truth, groups))
        print(f"{path.name:<26}" + "".join(f"{each:9.1f}" for each in np.mean(falls, axis=0)), flush=True)


def show_limits(models):
    """Print a row for each model."""
    print(f"{'model':<26}{'plain':>28}{'clipped':>28}{'fall-off':>28}")
    for path in models:
        scene = MeasuredScene.of(path)
        groups, cells = scene.joined(), []
        for kind in KINDS:
            falls = []
            for seed in (1, 2):
                truth, exposed = scene.exposed(seed, **kind)
                for without_paint in (False, True):
                    after = scene.informed(seed, without_paint=without_paint, **kind).clip(0, 1)
                    falls += [fall(exposed, after, truth, each) for each in (None, groups)]
            means = np.mean(np.reshape(falls, (2, 4)), axis=0)
            cells.append("{:6.1f} ({:4.1f}) /{:5.1f} ({:4.1f})".format(*means))
        print(f"{path.name:<26}" + "".join(f"{cell:>28}" for cell in cells), flush=True)


def compare_jpeg(models):
    """Print a row for each model."""
    qualities = 98, 92, 85
    print(f"{'model':<26}" + "".join(f"{f'quality {each}':>22}" for each in qualities))
    for path in models:
        scene, cells = MeasuredScene.of(path), []
        for quality in qualities:
            falls = []
            for seed in (1, 2):
                truth, exposed = scene.exposed(seed)
                stored = scene.as_jpeg(exposed, quality)
                shown = stored.truth
                found = (
                    stored.levelled(shown)[0],
                    stored.levelled_as_file(),
                    scene.restored(seed, shown=shown),
                )
                falls.append([fall(shown, each.clip(0, 1), truth) for each in found])
            cells.append("{:.1f} -> {:.1f} / {:.1f}".format(*np.mean(falls, axis=0)))
        print(f"{path.name:<26}" + "".join(f"{each:>22}" for each in cells), flush=True)


def write_large(folder, across=56, size=4096):
    """Write a torus whose squares are charts of one texture, each with an exposure of its own, as an OBJ file."""
    row, column = np.mgrid[:across, :across].reshape(2, -1)
    around, along = (2 * np.pi * each / across for each in (row, column))
    points = [(3 + np.cos(along)) * np.cos(around), (3 + np.cos(along)) * np.sin(around), np.sin(along)]
    lines = ["mtllib large.mtl", "usemtl all"]
    lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in np.transpose(points)]
    faces = []
    for number, (down, right) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
        places = (row + down) % across * across + (column + right) % across
        faces.append([f"{place + 1}/{number * across**2 + chart + 1}" for chart, place in enumerate(places)])
        inside = np.column_stack([column + 0.04 + 0.92 * right, across - (row + 0.04 + 0.92 * down)]) / across
        lines += [f"vt {u:.6f} {v:.6f}" for u, v in inside]
    lines += ["f " + " ".join(each) for each in zip(*faces, strict=True)]
    (folder / "large.obj").write_text("\n".join(lines) + "\n")
    (folder / "large.mtl").write_text("newmtl all\nmap_Kd large.png\n")
    random, texel = np.random.default_rng(0), np.arange(size)
    chart = (texel * across // size)[:, None] * across + texel * across // size
    turns = 2 * np.pi * texel / size
    image = (
        0.5 + 0.2 * np.sin(9 * turns)[:, None] * np.cos(7 * turns) + random.normal(0, 2 / 255, (size, size))
    )
    gain, offset = (random.uniform(*each, (across**2, 3)) for each in (GAINS, (-OFFSET, OFFSET)))
    pixels = np.rint(255 * np.clip(image[..., None] * gain[chart] + offset[chart], 0, 1)).astype(np.uint8)
    (folder / "large.png").write_bytes(write_image(new_picture(pixels, "texture"), pixels).data)


def time_large(_):
    """Print what the command says, its processor time and its memory."""
    with tempfile.TemporaryDirectory() as name:
        write_large(Path(name))
        command = [sys.executable, "-m", "beltrami_cli", "level", "large.obj", "out.obj", "--threads", "1"]
        subprocess.run(command, cwd=name, check=True)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(f"{used.ru_utime + used.ru_stime:.1f} s of processor time, {used.ru_maxrss / 2**20:.2f} GiB")


def main(arguments):
    """Print a row for each model."""
    models = [Path(each) for each in arguments if not each.startswith("--")]
    models = models or [SAMPLES / name for name in NAMES]
    modes = {"--spaces": compare_spaces, "--told": show_limits, "--jpeg": compare_jpeg, "--large": time_large}
    for option, show in modes.items():
        if option in arguments:
            show(models)
            return
    print(f"{'model':<26}{'plain':>14}{'clipped':>19}{'fall-off':>14}{'as it is':>11}{'s':>6}")
    for path in models:
        scene = MeasuredScene.of(path)
        groups, cells, spent = scene.joined(), [], 0.0
        for kind in KINDS:
            found = [measured(scene, seed, kind, groups) for seed in (1, 2)]
            whole, apart, known, seconds = np.mean(found, axis=0)
            behind = f" /{known:4.1f}" if kind.get("clipped") else ""
            cells.append(f"{whole:6.1f} ({apart:4.1f}){behind}")
            spent = max(spent, seconds)
        same, _ = scene.levelled(scene.truth)
        change = 255 * float(np.abs(same - scene.truth.astype(np.float32)).mean())
        row = f"{cells[0]:>14}{cells[1]:>19}{cells[2]:>14}{change:11.2f}{spent:6.1f}"
        print(f"{path.name:<26}{row}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
