"""What cannot be done is refused in one line that names the cause, with the documented code, and nothing is written."""

import os
import shlex
import shutil
import sys
from functools import partial
from importlib.metadata import packages_distributions, requires

import numpy as np
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from batch.batches import without_workers
from beltrami_cli.view import before_after
from beltrami_cli.view.settings import RenderSettings
from cli.commands import SAMPLES, beltrami, refused
from cli.pictures import coloured_file, pixels
from formats.image_files import encode
from formats.volume_files import nrrd_file
from oracles.level_sets import sphere
from small_models import textured_squares

VERTICES = 2539  # of terrain-noisy.ply


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Files that do not fit; no test may change them."""
    path = tmp_path_factory.mktemp("inputs")
    hollow = np.zeros(VERTICES)
    hollow[7] = np.inf
    for name, array in {"odd": np.zeros((3, 3)), "hollow": hollow, "words": np.full(VERTICES, "a")}.items():
        np.save(path / f"{name}.npy", array)
    (path / "damaged.npy").write_bytes((path / "hollow.npy").read_bytes()[:-9])
    np.savez(path / "many.npz", one=np.zeros(VERTICES), two=np.zeros(VERTICES))
    coloured_file(path / "points.ply", np.eye(3), np.zeros((0, 3), int), np.eye(3))
    numbers = np.random.default_rng(0).integers(0, 256, (9, 7))
    np.savetxt(path / "scan.txt", numbers, "%d", ",")
    (path / "colourless.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (path / "bad.ply").write_bytes(b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nend_header\n")
    (path / "list.json").write_text("[]")
    (path / "image.ply").write_bytes(encode(np.full((4, 4, 3), 9, np.uint8), "png"))
    np.savez(path / "level_set.npz", values=np.zeros((2, 2, 2)))
    (path / "kept").mkdir()
    (path / "kept" / "there.ply").write_bytes(b"kept")
    (path / "frames").mkdir()
    shutil.copy(SAMPLES / "head-tex-clean.png", path / "frames" / "1.png")
    for name in ("one", "other"):  # with one image too small for a window of 11 x 11
        (path / name).mkdir()
        textured_squares(path / name / "m.obj", ("a.png", 0, (0, 1)), ("b.png", 2, (0, 1)))
        for image, side in (("a", 64), ("b", 6)):
            (path / name / f"{image}.png").write_bytes(encode(np.full((side, side, 3), 9, np.uint8), "png"))
    if hasattr(os, "mkfifo"):
        os.mkfifo(path / "fifo.ply")
    return path


# Of each command: the words, in which @ stands for the folder of samples; the exit code; what the line says.
REFUSED = [
    # commands
    ("smooth scan.ply clean.ply --config a.toml", 2, "--config goes before the command: beltrami --config FILE smooth"),
    ("info scan.ply -V", 2, "-V goes before the command: beltrami -V\n"),
    ("smoth clean.ply", 2, "Did you mean smooth?"),
    ("scan.ply clean.ply", 2, "beltrami smooth scan.ply OUTPUT"),
    ("frob clean.ply", 2, "'frob'.\n"),
    ("docs tunning", 2, "Did you mean tuning?"),
    ("docs noise", 2, "Did you mean commands or method or tuning?"),  # which have such headings
    ("batch . --out-dir out --json", 2, "The JSON goes into a file: --report FILE.jsonl"),
    # inputs
    ("smooth missing.ply out.ply", 3, "missing.ply"),
    ("smooth . out.ply", 3, "it is a folder"),
    ("smooth frames out", 3, "beltrami batch frames --out-dir OUT"),
    ("batch frames --out-dir out", 3, "'frames/*.png'"),
    ("smooth fifo.ply out.ply", 3, "pipe"),
    ("info colourless.obj", 3, "colourless.obj: "),
    ("info bad.ply", 3, "bad.ply: "),
    ("check bad.ply bad.ply", 3, "bad.ply: "),
    ("info none*.ply", 3, "none*.ply"),
    ("info scan.txt --columns x,y,z,r,g,b", 3, "7 numbers each, but --columns has 6 names; give --columns"),
    ("info scan.txt --columns ,", 2, "columns"),
    # outputs
    ("smooth @knot-noisy.ply", 2, "OUTPUT"),
    ("smooth @knot-noisy.ply ''", 4, "OUTPUT: its name is empty; name a file, or - for standard output"),
    ("smooth @knot-noisy.ply out.abc", 2, ".abc"),
    ("smooth @mirrored-noisy.obj out.glb --texture-format webp", 2, "PNG and JPEG textures, not .webp"),
    ("smooth @knot-noisy.ply out.vrm", 2, "a .ply file is not converted to .vrm"),
    ("smooth @knot-noisy.ply out.stl", 2, "out.stl: .stl files are read, but not written: the STL format"),
    ("smooth @knot-noisy.ply kept", 4, "kept: is a folder; name a file"),
    ("smooth @knot-noisy.ply none/x.ply", 4, "none/x.ply: the folder none does not exist; make it first"),
    ("smooth @knot-noisy.ply kept/there.ply/x.ply", 4, "kept/there.ply is not a folder; choose another place"),
    (f"smooth @knot-noisy.ply kept/{300 * 'x'}.ply", 4, ".ply: no file can be called so (File name too long)"),
    ("smooth @knot-noisy.ply picture.png", 2, "picture.png draws it"),
    ("smooth @knot-noisy.ply picture.fits", 2, "picture.png draws it"),
    ("smooth @knot-noisy.ply out.ply --report nowhere/r.json", 4, "nowhere"),
    ("smooth @knot-noisy.ply s3://b/o.ply", 4, "it is a URL"),
    ("render @knot-noisy.ply s3://b/o.png", 4, "it is a URL"),
    ("smooth @knot-noisy.ply - --report -", 4, "would mix with OUTPUT"),
    ("bake @nonmanifold-noisy.ply - --to texture --json", 4, "would mix with OUTPUT"),
    ("smooth @knot-noisy.ply out.ply --preview a.txt", 2, "a.txt"),
    ("smooth @knot-noisy.ply out.ply --preview a.png --dry-run", 2, "--preview"),
    ("smooth - out.ply --preview a.png", 2, "--preview"),
    ("render @mirrored-noisy.png out.ply", 2, "call it .png"),
    ("report @knot-noisy.ply @knot-clean.ply page.txt", 2, "page.txt"),
    ("sweep @nonmanifold-noisy.ply a.txt -n 1", 2, "no image format"),
    ("sweep absent.ply a.gif -n 1", 2, "cannot be written as GIF"),
    ("bake @nonmanifold-noisy.ply out.abc --to texture", 2, "no format is known"),
    ("bake @nonmanifold-noisy.ply - --to texture", 4, "<stdout>: there is no folder for its sidecar files; "),
    ("batch @nonmanifold-noisy.ply --out-dir out --suffix=/x", 2, "/x"),
    ("batch @nonmanifold-noisy.ply --out-dir memory://x", 2, "name it with --report"),
    ("batch @nonmanifold-noisy.ply --out-dir out --report -", 2, "name a file"),
    # values
    ("smooth @terrain-noisy.ply out.ply --bogus", 2, "--bogus"),
    ("smooth @terrain-noisy.ply out.ply --gutter ²", 2, "gutter"),
    (f"smooth @terrain-noisy.ply out.ply --gutter {5000 * '9'}", 2, "gutter"),
    ("smooth @terrain-noisy.ply out.ply --channels infrared", 2, "infrared"),
    ("smooth @terrain-noisy.ply out.ply --channels ' , '", 2, "--channels names nothing"),
    ("smooth @terrain-noisy.ply out.ply --slots ''", 2, "--slots names nothing"),
    ("smooth @terrain-noisy.ply out.ply --slots paint", 2, "one of --slots is paint, but must be baseColor"),
    ("smooth @terrain-noisy.ply out.ply --texture-format gif", 2, "--texture-format is .gif, but must be .png"),
    ("smooth @terrain-noisy.ply out.ply --strength weak", 2, "--strength is 'weak'"),
    ("smooth @terrain-noisy.ply out.ply --strength 0.69", 2, "--strength is 0.69"),
    ("smooth @terrain-noisy.ply out.ply --max-memory lots", 2, "not a size"),
    ("smooth @terrain-noisy.ply out.ply --max-memory 0", 2, "no memory"),
    ("noise @terrain-noisy.ply out.ply --sigma 300", 2, "beltrami: --sigma is 300, but must be at most 255"),
    ("noise @terrain-noisy.ply out.ply --sigma 5 --quality 50", 2, "--quality is of jpeg noise, not of gaussian"),
    ("noise @terrain-noisy.ply out.ply --sigma 0.08", 2, "8%"),
    *(
        (f"{command} 0.9", 2, "is ambiguous: of 255 or of full scale; write 0.9/255 or 90%")
        for command in (
            "smooth @terrain-noisy.ply out.ply --noise", "info @terrain-noisy.ply --noise",
            "sweep @terrain-noisy.ply a.gif --noise", "batch @terrain-noisy.ply --out-dir out --noise",
            "noise @terrain-noisy.ply out.ply --sigma", "view @terrain-noisy.ply --noise",
        )
    ),
    ("noise @terrain-noisy.ply out.ply --sigma=-1", 2, "from 0"),
    ("noise @terrain-noisy.ply out.ply --sigma 1/0", 2, "amount"),
    ("render @head-clean.ply a.png --size big", 2, "1280x720"),
    ("render @head-clean.ply a.png --size 999999999x20", 2, "16 and 16384"),
    ("render @head-clean.ply a.png --crop 2,3", 2, "X,Y,SIDE"),
    ("render @head-clean.ply a.png --background blue", 2, "#rrggbb"),
    ("render @head-clean.ply a.png --label a --label ''", 2, "2 labels for 1 files"),
    ("render @head-clean.ply a.png --size 10000", 2, "lower --size"),
    ("sweep @nonmanifold-noisy.ply a.png", 2, "nothing is varied"),
    ("sweep @nonmanifold-noisy.ply a.csv --format csv --strength strong", 2, "nothing is varied"),
    ("sweep @nonmanifold-noisy.ply a.png -n 1,1000000000", 2, "between 0 and 10000"),
    ("sweep @nonmanifold-noisy.ply a.png --beta 1,x", 2, "list of numbers"),
    (f"sweep @nonmanifold-noisy.ply a.png -n {','.join(map(str, range(300)))}", 2, "too many"),
    # options that need, or contradict, each other
    ("smooth @terrain-noisy.ply out.ply --units world", 2, "--units world needs -t"),
    ("smooth @terrain-noisy.ply out.ply --channels r --space oklab", 2, "oklab"),
    ("smooth @terrain-noisy.ply out.ply --metric-channels r --space oklab", 2, "oklab"),
    ("smooth @terrain-noisy.ply out.ply --metric-channels x", 2, "no channel x"),
    ("smooth @terrain-noisy.ply out.ply --metric-channels r,none", 2, "or none"),
    ("smooth @terrain-noisy.ply out.ply --normal-beta 1", 2, "add --smooth-geometry"),
    ("smooth @terrain-noisy.ply out.ply --guide-beta 1", 2, "add --guide"),
    ("smooth @terrain-noisy.ply out.ply --guide @terrain-clean.ply --guide-beta 1 --guide-beta 2", 2, "has 2 values"),
    ("smooth @terrain-noisy.ply out.glb --texture-size 64", 2, "--unwrap"),
    ("smooth @terrain-noisy.ply out.glb --unwrap --smooth-geometry", 2, "--unwrap"),
    ("smooth @terrain-noisy.ply out.glb --unwrap --on both", 2, "--on"),
    ("smooth @terrain-noisy.ply out.glb --unwrap --slots normal", 2, "--slots"),
    ("smooth @terrain-noisy.ply out.glb --unwrap --texture-format tif", 2, "PNG and JPEG"),
    ("smooth @head-tex-noisy.glb out.glb --unwrap --guide normal", 2, "--unwrap"),
    ("noise @knot-clean.ply o.ply --kind jpeg", 2, "beltrami bake"),
    ("noise @knot-clean.ply o.ply --kind grain", 2, "--sigma"),
    ("bake @nonmanifold-noisy.ply out.glb", 2, "--to"),
    ("bake @nonmanifold-noisy.glb out.vrm --to texture", 2, ".vrm files are not made from a new mesh"),
    ("bake @head-tex-noisy.glb out.vrm --to vertices", 2, ".vrm files are not made from a new mesh"),
    ("render @nonmanifold-noisy.ply a.jpg --background transparent", 2, "no transparent background"),
    ("sweep - a.png --beta 1", 2, "not a pipe"),
    ("report - @knot-clean.ply page.html", 2, "pipe"),
    ("level @head-tex-clean.glb out.glb --reference-charts absent*", 2, "--reference-charts absent*"),
    ("level @head-tex-clean.glb out.glb --reference-charts *", 2, "keeps all charts"),
    ("batch bad.ply --out-dir out --pieces 2 --smooth-geometry", 2, "bad.ply: vertices are not moved in pieces"),
    # options and files that do not fit each other
    ("smooth @terrain-noisy.ply out.ply --on texture", 3, "terrain-noisy.ply: "),
    ("smooth @terrain-noisy.ply out.ply --on both", 3, "terrain-noisy.ply: "),
    ("smooth @tiled-clean.glb o.glb --on vertices", 3, "textures, but no vertex colours; smooth these"),
    ("bake @tiled-clean.glb o.glb --to texture", 3, "textures, but no vertex colours"),
    ("smooth @mirrored-noisy.obj o.obj --on vertices", 3, "textures, but no vertex colours; smooth these"),
    ("smooth @torus-two-noisy.gltf o.gltf --slots normal", 3, "no normal textures, only baseColor textures"),
    ("smooth @terrain-noisy.ply o.ply --slots normal", 3, "it has no textures; leave out --slots"),
    ("smooth @terrain-noisy.ply out.ply --guide nothing", 3, "no such file, and no attribute"),
    ("smooth @terrain-noisy.ply out.ply --guide @knot-noisy.ply", 3, f"do not fit the {VERTICES} vertices"),
    ("smooth @terrain-noisy.ply out.ply --guide odd.npy", 3, "3 x 3 numbers do not fit"),
    ("smooth @terrain-noisy.ply out.ply --guide many.npz", 3, "which of its arrays one, two is meant"),
    ("smooth @terrain-noisy.ply out.ply --guide hollow.npy", 3, "its row 7 is not finite"),
    ("smooth @terrain-noisy.ply out.ply --guide words.npy", 3, "not of real numbers"),
    ("smooth @terrain-noisy.ply out.ply --guide damaged.npy", 3, "too few numbers"),
    ("smooth @head-tex-noisy.obj out.obj --guide normal", 3, "the slots of"),
    ("smooth @head-tex-noisy.obj out.obj --guide @scan-clean.jpg", 3, "do not fit the"),
    ("smooth @head-tex-noisy.obj out.obj --guide @terrain-noisy.ply", 3, "no known image format"),
    ("smooth @torus-two-noisy.gltf o.gltf --guide @head-tex-noisy.png", 2, "--texture"),
    ("smooth @head-tex-noisy.png out.png --guide @scan-clean.jpg", 3, "do not fit the"),
    ("smooth points.ply out.ply --smooth-geometry", 3, "no triangles"),
    ("smooth scan.txt out.xyz --columns x,y,z,r,g,b,scalar --unwrap", 2, ".xyz file has no textures"),
    ("smooth points.ply out.ply --unwrap", 3, "triangulate the points first"),
    ("smooth @terrain-noisy.ply out.glb --unwrap --on texture", 3, "no texture"),
    ("smooth @head-tex-noisy.png out.png --unwrap", 3, "head-tex-noisy.png: it is an image"),
    ("smooth @terrain-noisy.ply out.ply --colours missing.npz", 2, "--colours"),
    ("level @head-noisy.ply out.ply", 3, "nothing says which photograph"),
    ("level @head-tex-clean.png out.png", 2, "head-tex-clean.png: an image has no charts"),
    ("bake points.ply out.glb --to texture", 3, "no triangles"),
    ("bake @nonmanifold-noisy.ply out.ply --to vertices", 3, "no texture"),
    ("bake @nonmanifold-noisy.ply out.glb --to texture --max-unwrap-faces 9", 3, "--max-unwrap-faces "),
    ("bake @nonmanifold-noisy.ply out.glb --to texture --size 16 --padding 3", 1, "do not fit"),
    ("render @head-clean.ply a.png --show texture", 3, "has no baseColor texture"),
    ("check @nonmanifold-noisy.ply @nonmanifold-noisy.obj", 2, "nonmanifold-noisy.obj"),
    ("compare one/m.obj other/m.obj --min-ssim 0.9 --map map.png --json", 3, "b.png: --min-ssim"),
    ("report @knot-noisy.ply @knot-clean.ply page.html --parameters list.json", 3, "list.json"),
    ("report @knot-noisy.ply @head-clean.ply page.html", 3, "head-clean.ply"),
    ("report @knot-noisy.ply @scan-clean.jpg page.html", 3, "scan-clean.jpg"),
    ("sweep @nonmanifold-noisy.ply a.png -n 1 --reference @knot-clean.ply --size 32", 3, "nonmanifold-noisy.ply"),
    # images
    ("smooth @head-tex-noisy.png out.glb", 2, "is an image, not a model"),
    ("check @head-tex-noisy.png @head-tex-noisy.png", 3, "is an image, not a model; give a mesh"),
    ("check level_set.npz level_set.npz", 3, "is a level set, not a model; give a mesh"),
    ("smooth image.ply out.ply", 2, "image.ply is an image, not a model"),
    ("smooth @head-tex-noisy.png out.gif", 2, "cannot be written as GIF"),
    ("smooth @head-tex-noisy.png out.pgm", 2, "PGM holds grey only"),
    ("smooth @mirrored-noisy.png out.png --space oklab", 2, "grey"),
    ("smooth @head-tex-noisy.png out.png --height a --positions b", 2, "two surfaces"),
    ("smooth @head-tex-noisy.png out.png --height-scale 2", 2, "add --height"),
    ("smooth @head-tex-noisy.png out.png --height a --height-scale nan", 2, "finite"),
    ("smooth @head-tex-noisy.png out.png --height @mirrored-noisy.png", 3, "do not fit the 416 x 416"),
    ("smooth @head-tex-noisy.png out.png --positions @sphere-exr-noisy.exr", 3, "do not fit the 416 x 416"),
    ("smooth @head-tex-noisy.png out.png --mask @mirrored-noisy.png", 3, "do not fit the 416 x 416"),
    ("smooth @head-tex-noisy.png out.png --height @head-tex-clean.png", 3, "which of its channels R, G, B"),
    ("smooth @mirrored-noisy.png out.png --positions @mirrored-clean.png", 3, "its channels Y are not positions"),
    ("smooth @head-tex-noisy.png out.png --mask absent.png", 3, "absent.png: there is no such file"),
    # places of kernels
    ("kernel --fast @nonmanifold-noisy.ply k.ply --at 999999", 2, "vertex"),
    ("kernel --fast @nonmanifold-noisy.ply k.ply --at 0.1,0.2", 2, "vertex"),
    ("kernel --fast @nonmanifold-noisy.ply k.ply --at nowhere", 2, "cannot be understood"),
    ("kernel --fast @nonmanifold-noisy.ply k.ply --at nan,0,0", 2, "cannot be understood"),
    ("kernel --fast @nonmanifold-noisy.ply k.png --at 12", 2, ".ply"),
    ("kernel --fast @nonmanifold-noisy.ply k.xyz --at 12", 2, "k.xyz: a kernel is written as .ply, .png or .csv"),
    ("kernel --fast @tiled-noisy.glb k.png --at 12", 2, "texture coordinates"),
    ("kernel --fast @head-tex-noisy.glb k.png --at 1.2,0.3", 2, "0 to 1"),
    ("kernel --fast @tiled-noisy.glb k.ply --at 0.3,0.3", 2, ".png"),
    ("kernel --fast @torus-two-noisy.gltf k.png --at 0.3,0.3", 2, "several textures"),
    ("kernel --fast @torus-two-noisy.gltf k.png --at nosuch*:0.3,0.3", 2, "no texture"),
    ("kernel --fast @mirrored-noisy.png k.png --at -1,3", 2, "is not inside"),
    ("kernel --fast @mirrored-noisy.png k.png --at 3,320", 2, "is not inside"),
]  # fmt: skip


ABSENT = [
    "--config absent smooth @knot-noisy.ply o.ply", "smooth absent o.ply", "info absent",
    "noise absent o.ply --sigma 9",
    "bake absent o.ply --to texture", "level absent o.ply", "compare @knot-noisy.ply absent", "check absent absent",
    "report absent absent o.html", "report @knot-noisy.ply @knot-noisy.ply o.html --parameters absent",
    "render absent o.png", "sweep absent o.png --beta 5,8", "view absent --no-open", "kernel absent o.csv --at 3",
    "batch absent --out-dir out", "batch absent.toml --out-dir out", "smooth @knot-noisy.ply o.ply --noise absent.exr",
    "smooth @scan-noisy.jpg o.png --height absent",
]  # fmt: skip


@pytest.mark.parametrize("words", ABSENT)
def test_a_file_that_is_not_there_is_said_to_be_so(words, folder):
    arguments = [word.replace("@", f"{SAMPLES}/") for word in words.split()]
    line = refused(folder, *arguments, code=3, said="absent")
    assert ": there is no such file; check" in line
    assert "Errno" not in line


@pytest.mark.parametrize("words", [words for words in ABSENT if not words.startswith(("--config", "batch"))])
def test_a_url_is_said_to_be_one_whether_or_not_the_extra_is_installed(words, folder, monkeypatch):
    hide("fsspec", monkeypatch)
    arguments = [
        word.replace("@", f"{SAMPLES}/").replace("absent", "https://a.org/b") for word in words.split()
    ]
    assert "it is a URL" in refused(folder, *arguments, code=3, said="https://a.org/b")


def test_an_unknown_format_names_kinds_that_are_read_images_among_them(tmp_path):
    (tmp_path / "text.png").write_text("hello")
    line = refused(tmp_path, "smooth", "text.png", "out.png", code=3, said="no known format")
    assert all(suffix in line for suffix in (".png", ".jpg", ".exr", ".ply", ".las", ".nrrd"))


@pytest.mark.parametrize(("words", "code", "said"), REFUSED, ids=[words[:99] for words, *_ in REFUSED])
def test_it_is_refused_in_one_line_and_nothing_is_written(words, code, said, folder):
    if "fifo" in words and not hasattr(os, "mkfifo"):
        pytest.skip("there are no FIFOs")
    if words.startswith(("render", "sweep")):
        pytest.importorskip("embreex")
    refused(folder, *(word.replace("@", f"{SAMPLES}/") for word in shlex.split(words)), code=code, said=said)


def hide(module, monkeypatch):
    """Make importing a module fail, and what of it other tests have imported."""
    for name in {module, *(name for name in sys.modules if name.startswith(f"{module}."))}:
        monkeypatch.setitem(sys.modules, name, None)


@pytest.mark.parametrize(
    ("module", "extra", "words", "code"),
    [
        ("distributed", "cluster", "batch @knot-noisy.ply --out-dir out --scheduler tcp://127.0.0.1:1", 1),
        ("fsspec", "cluster", "batch memory://x/a.ply --out-dir out", 3),
        ("skimage.measure", "volumes", "smooth volume.nrrd out.ply", 3),
        ("nrrd", "volumes", "smooth volume.nrrd out.ply", 3),
    ],
)
def test_the_command_that_installs_a_missing_extra_is_named(
    module, extra, words, code, tmp_path, monkeypatch
):
    hide(module, monkeypatch)
    (tmp_path / "volume.nrrd").write_bytes(nrrd_file(sphere(0.4)[0]))
    words = words.replace("@", f"{SAMPLES}/").split()
    (line,) = beltrami(*words, code=code, cwd=tmp_path, text=True).stderr.splitlines()
    assert f"{shlex.quote(sys.executable)} -m pip install 'beltrami-cli[{extra}]'" in line


def test_pictures_of_surfaces_need_no_extra(tmp_path, monkeypatch):
    pytest.importorskip("embreex")
    needed = [Requirement(text) for text in requires("beltrami-cli")]
    (extras,) = (
        each.extras for each in needed if each.name == "beltrami-cli" and 'extra == "all"' in str(each.marker)
    )

    def installed_with(extra):
        return {
            canonicalize_name(each.name)
            for each in needed
            if each.marker is None or each.marker.evaluate({"extra": extra})
        }

    optional = set.union(*map(installed_with, extras)) - installed_with("")
    for module, distributions in packages_distributions().items():
        if {*map(canonicalize_name, distributions)} <= optional:
            hide(module, monkeypatch)
    source = f"{SAMPLES}/nonmanifold-noisy.ply"
    monkeypatch.setattr(before_after, "RenderSettings", partial(RenderSettings, size=(30, 30)))
    beltrami("smooth", source, "a.ply", "--fast", "--preview", "a.png", cwd=tmp_path)
    beltrami("render", source, "b.png", "--size", "30", cwd=tmp_path)
    beltrami("sweep", source, "c.png", "--fast", "--beta", "4,8", "--size", "30", cwd=tmp_path)
    assert all((tmp_path / f"{name}.png").exists() for name in "abc")


@pytest.mark.parametrize("module", ["dask", "distributed", "embreex", "fsspec", "nrrd", "skimage"])
def test_nothing_else_misses_an_extra(module, tmp_path, monkeypatch):
    hide(module, monkeypatch)
    (tmp_path / "p.xyz").write_text("0 0 0 255 0 0\n1 0 0 255 0 0\n1 1 0 255 0 0\n0 1 0 255 0 0\n")
    beltrami("smooth", "p.xyz", "q.ply", "--fast", cwd=tmp_path)
    with without_workers():
        beltrami("batch", "p.xyz", "--out-dir", "out", "--fast", cwd=tmp_path)
    beltrami("render", "p.xyz", "p.png", "--size", "30", cwd=tmp_path)
    beltrami("render", "p.png", "q.png", "--size", "30", cwd=tmp_path)
    assert (pixels(tmp_path / "p.png")[10:20, 10:20] == [255, 0, 0]).all()
    assert (pixels(tmp_path / "p.png") == pixels(tmp_path / "q.png")).all()


def test_a_traceback_comes_on_demand_only(folder):
    plain = refused(folder, "info", "bad.ply", code=3)
    reported = beltrami("info", "bad.ply", "-vv", code=3, cwd=folder, text=True)
    assert "Traceback" in reported.stderr
    assert reported.stderr.endswith(plain)
