"""An option that can have no effect on the input is refused, and not ignored."""

import numpy as np
import pytest

from batch.batches import without_workers
from beltrami_cli.cli.parameter_options import ParameterOption
from beltrami_cli.cli.registry import COMMANDS
from beltrami_cli.errors import UsageError
from beltrami_cli.formats.files.access import DEFAULT_ACCESS, Access
from beltrami_cli.jobs.opening import open_any
from beltrami_cli.layers.selection import select
from beltrami_cli.layers.settings import SmoothSettings
from cli.commands import SAMPLES, beltrami, command, refused

VERTICES, TEXTURES, IMAGES, TEXT = "vertex colours", "textures", "images", "points in text files"
MODELS = (VERTICES, TEXTURES)
# The kinds of input on which each option of a command has an effect; first those that have one on all.
NAMES_OF = {
    (): "allow-outside background beta beta-growth channels clipping crop exposure-strength fast grain-size guide "
    "guide-beta iterations keep-uv kind label max-delta-e max-memory max-move max-seam-jump max-unwrap-faces "
    "metric-channels metric-scale metric-steps min-psnr min-ssim noise outliers padding patches quality read "
    "reference-charts seed shot side-by-side sigma size space strength texture-size threads threshold time-step "
    "units zoom",
    (VERTICES,): "max-samples normal-beta photographs smooth-geometry solver weights",
    (TEXTURES,): "gutter material slot slots texture texture-format",
    MODELS: "azimuth elevation fov level lit on show up view",
    (TEXTURES, IMAGES): "alpha jpeg-quality small window",
    (IMAGES,): "height height-scale mask positions",
    ("level sets",): "colours inside iso max-voxels",
    (TEXT,): "columns",
}
KINDS = {name: {*kinds} for kinds, names in NAMES_OF.items() for name in names.split()}
# In comparisons samples of textures can count by their area, too.
ELSEWHERE = {"compare": {"weights": {*MODELS}}}
DECLARED = [
    (name, option.declared)
    for name in COMMANDS
    for option in command(name).params
    if isinstance(option, ParameterOption)
]


def long_name(declared):
    return declared.flag.lstrip("-").partition("/")[0]


def test_every_option_says_on_what_kinds_of_input_it_has_an_effect():
    for name, declared in DECLARED:
        kinds = {**KINDS, **ELSEWHERE.get(name, {})}
        assert {*declared.of} == kinds[long_name(declared)], (name, declared.flag)


@pytest.fixture(scope="module")
def documents(tmp_path_factory):
    text = tmp_path_factory.mktemp("points") / "points.xyz"
    np.savetxt(text, np.random.default_rng(0).integers(0, 256, (50, 6)), "%d", header="x y z r g b")
    sources = {
        VERTICES: SAMPLES / "nonmanifold-noisy.ply", TEXTURES: SAMPLES / "tiled-clean.glb",
        IMAGES: SAMPLES / "mirrored-noisy.png", TEXT: text,
    }  # fmt: skip
    return {kind: open_any(str(source), SmoothSettings(), DEFAULT_ACCESS) for kind, source in sources.items()}


@pytest.mark.parametrize("kind", [VERTICES, TEXTURES, IMAGES, TEXT])
def test_it_is_refused_on_every_other_kind_of_input(kind, documents):
    kinds = {kind, VERTICES} if kind == TEXT else {kind}
    for _, declared in DECLARED:
        documents[kind].access = Access(typed=(declared,))
        if not declared.of or kinds & {*declared.of}:
            select(documents[kind], SmoothSettings())
        else:
            with pytest.raises(UsageError, match=f"{declared.flag} has no effect on"):
                select(documents[kind], SmoothSettings())


def test_a_quality_that_no_written_image_has_is_warned_of(tmp_path):
    for name, is_lossy in (("a.png", False), ("a.jpg", True)):
        options = ("-n", 1, "--jpeg-quality", 90, "--overwrite")
        run = beltrami("smooth", SAMPLES / "mirrored-noisy.png", tmp_path / name, *options, text=True)
        assert ("--jpeg-quality has no effect" in run.stderr) != is_lossy


REFUSED = [
    "smooth @nonmanifold-noisy.ply o.ply --jpeg-quality 50",
    "smooth @nonmanifold-noisy.ply o.ply --jpeg-quality 98",  # the default
    "smooth @nonmanifold-noisy.ply o.glb --unwrap --mask m.png",
    "smooth @tiled-clean.glb o.glb --solver segments",
    "level @tiled-clean.glb o.glb --photographs x",
    "noise @nonmanifold-noisy.ply o.ply --sigma 3 --gutter 3",
    "info @nonmanifold-noisy.ply --alpha smooth",
    "kernel @nonmanifold-noisy.ply o.csv --at 3 --window 9",
    "compare @mirrored-noisy.png @mirrored-noisy.png --slots normal",
    "sweep @nonmanifold-noisy.ply o.csv --format csv --beta 3 --texture-format png",
    "view @mirrored-noisy.png --solver segments",
    "render @mirrored-noisy.png o.png --lit",
]


@pytest.mark.parametrize("words", REFUSED)
def test_each_command_refuses_it(words, tmp_path):
    refused(
        tmp_path,
        *(word.replace("@", f"{SAMPLES}/") for word in words.split()),
        code=2,
        said="has no effect on",
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("bake @tiled-clean.glb o.ply --to vertices --size 64", "--size is of the new texture"),
        (
            "smooth @nonmanifold-noisy.ply o.ply --max-unwrap-faces 9",
            "--max-unwrap-faces is of the new texture",
        ),
        ("sweep @nonmanifold-noisy.ply o.csv --format csv --beta 3 --size 64", "--size is of pictures"),
    ],
)
def test_what_the_command_does_not_make_takes_no_options(words, said, tmp_path):
    refused(tmp_path, *(word.replace("@", f"{SAMPLES}/") for word in words.split()), code=2, said=said)


def test_what_stands_in_a_file_or_the_environment_is_for_the_inputs_that_it_fits(tmp_path):
    (tmp_path / "beltrami.toml").write_text("[smooth]\njpeg-quality = 50\nwindow = 9\n")
    words = ("smooth", SAMPLES / "nonmanifold-noisy.ply", "o.ply", "--fast")
    beltrami(*words, cwd=tmp_path, env={"BELTRAMI_SMOOTH_TEXTURE_FORMAT": "png"})


@pytest.mark.slow
def test_a_batch_warns_of_an_option_that_fits_none_of_its_files(tmp_path):
    vertices, textures = SAMPLES / "nonmanifold-noisy.ply", SAMPLES / "mirrored-noisy.obj"
    options = ("--jpeg-quality", 50, "--fast", "--overwrite")
    with without_workers():
        alone = beltrami("batch", vertices, "--out-dir", "out", *options, cwd=tmp_path, text=True)
        both = beltrami("batch", vertices, textures, "--out-dir", "out", *options, cwd=tmp_path, text=True)
    assert "warning: --jpeg-quality had no effect on any file" in alone.stderr
    assert "had no effect" not in both.stderr
