"""Compare time and memory of an iteration on textures with a pass of OpenCV's bilateral filter: ``make bench``.

All iterations start from the noisy colours. They alternate with the peer, so that a busy machine slows both. ``--texels
N`` is the side of the texture, larger than 128; the table has medians of ``--repeats N`` runs.
"""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import beltrami_cli
import textures
from beltrami_cli.flow.beltrami_flow import smooth_in_place
from beltrami_cli.formats.image.reading import read_texture
from beltrami_cli.formats.registry import open_document
from beltrami_cli.layers.texture_layer import TextureLayer
from harness import SIGMA, Row, arguments, show, smooth_apart
from peers import PeerError, bilateral_seconds

CONTRAST = 1.4  # beta times the noise
SMALL = 128  # texels per side of the texture whose memory is subtracted


def main() -> None:
    options = arguments(__doc__, texels=1024, repeats=5)
    with tempfile.TemporaryDirectory() as folder:
        times = time_rows(Path(folder), options.texels, options.repeats)
        rows = [*times, memory_row(Path(folder), options.texels)]
    show(rows, options)


def time_rows(folder: Path, texels: int, repeats: int) -> Iterator[Row]:
    """Measure an iteration and the set-up, in CPU time of one thread, on a torus in 16 charts."""
    scene, source = textures.torus(texels), folder / "noisy.obj"
    textures.write_obj(source, scene, scene.noisy)
    times: dict[str, list[float]] = {"bilateral": [], "set-up": [], "plain": [], "regularised": []}
    peer = "cv2.bilateralFilter(d = 7, float32)"
    for _ in range(repeats):
        try:
            times["bilateral"].append(bilateral_seconds(scene.noisy[0]))
        except PeerError as missing:
            times["bilateral"], peer = [np.nan], str(missing)
        for kind in ("regularised", "plain"):
            setup, iteration = stage_seconds(source, guided=kind == "regularised")
            times[kind].append(iteration)
        times["set-up"].append(setup)
    seconds = {what: float(np.median(found)) for what, found in times.items()}
    covered = int(scene.covered[0].sum())
    yield f"{peer}, per texel", f"{1e6 * seconds['bilateral'] / texels**2:.3f} us"
    for kind in ("plain", "regularised"):
        each = seconds[kind] / covered
        passes = each / (seconds["bilateral"] / texels**2)
        what = f"{covered:,} covered texels, {kind} iteration, 7 x 7, per covered texel"
        yield what, f"{1e6 * each:.3f} us, {passes:.2f} bilateral passes"
    yield "set-up", f"{seconds['set-up']:.3f} s, {seconds['set-up'] / seconds['plain']:.2f} plain iterations"


def stage_seconds(source: Path, *, guided: bool) -> tuple[float, float]:
    """Return the CPU seconds of making the manifold, without decoding images, and of an iteration."""
    # Averages of clipped noise are not restored, since the peer does not either.
    kernel = beltrami_cli.KernelParameters(
        iterations=1, t=2.4, beta=CONTRAST / SIGMA, window=7, threads=1, clipping="keep", metric_steps=int(guided),
    )  # fmt: skip
    settings = beltrami_cli.SmoothSettings(kernel=kernel)
    surface = open_document(str(source)).textured("baseColor")
    marks = [time.process_time()]
    for texture in surface.textures:
        read_texture(texture)
    marks.append(time.process_time())
    plan = TextureLayer.read(surface, "baseColor", settings).normalised().plan()
    marks.append(time.process_time())
    smooth_in_place(plan)
    decoding, setup, iteration = np.diff([*marks, time.process_time()])
    return setup - decoding, iteration


def memory_row(folder: Path, texels: int) -> Row:
    runs = []
    for size in (SMALL, texels):
        source, scene = folder / f"{size}.obj", textures.torus(size)
        textures.write_obj(source, scene, scene.noisy)
        words = "-n", "2", "--on", "texture", "--beta", str(CONTRAST / SIGMA)
        report, _ = smooth_apart(source, source.with_stem("smooth"), *words)
        covered = sum(slot["counts"]["covered"] for slot in report["textures"])
        runs.append((report["peak_memory"], covered))
    (least, few), (most, many) = runs
    return f"{texels} x {texels}: peak memory by covered texel", f"{(most - least) / (many - few):.0f} bytes"


if __name__ == "__main__":
    main()
