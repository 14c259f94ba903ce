"""Options from files and the environment: flags win, then variables, files, defaults; `beltrami config` shows which."""

import shutil
import tomllib

import pytest

from cli.commands import SAMPLES, beltrami, refused

NOISY = SAMPLES / "nonmanifold-noisy.ply"
QUICK = {"iterations": 1, "time-step": 0.5, "beta-growth": 1, "metric-steps": 0}


@pytest.fixture
def run(tmp_path):
    """Runs the command in a folder, with variables."""

    def checked(*arguments, code=0, cwd=tmp_path, **variables):
        done = beltrami(*arguments, cwd=cwd, env=variables, code=code)
        return done.stdout.decode() if code == 0 else done.stderr.decode()

    return checked


def written(options, table="smooth"):
    return f"[{table}]\n" + "".join(f"{name} = {value}\n" for name, value in options.items())


def in_force(output, command, option):
    """The value that `beltrami config` shows, and where from."""
    value = tomllib.loads(output).get(command, {}).get(option)
    lines = output.partition(f"[{command}]\n")[2].partition("\n[")[0].splitlines()
    line = next((line for line in lines if line.startswith(f"{option} = ")), "")
    return value, line.partition("  # ")[2]


@pytest.mark.slow
def test_flags_win_over_variables_over_files_over_defaults(run, tmp_path):
    (tmp_path / "beltrami.toml").write_text(written({**QUICK, "beta": 3}))

    def result(name, *flags, **variables):
        run("smooth", NOISY, name, *flags, **variables)
        return (tmp_path / name).read_bytes()

    def expected(beta):
        name = f"beta-{beta}.ply"
        flags = [text for option, value in QUICK.items() for text in (f"--{option}", value)]
        elsewhere = tmp_path / "elsewhere.toml"
        elsewhere.touch()  # so that only flags count
        run("--config", elsewhere, "smooth", NOISY, name, *flags, "--beta", beta)
        return (tmp_path / name).read_bytes()

    assert result("file.ply") == expected(3)
    assert result("variable.ply", BELTRAMI_SMOOTH_BETA="8") == expected(8)
    assert result("flag.ply", "--beta", "20", BELTRAMI_SMOOTH_BETA="8") == expected(20)


def test_config_shows_what_is_in_force_and_where_from(run, tmp_path):
    path = tmp_path / "beltrami.toml"
    path.write_text('threads = 2\n[smooth]\nbeta = 3\nchannels = ["red", "green"]\nsmall = true\n')
    parsed = {"RENDER_SIZE": "80x60", "RENDER_CROP": "auto,0.1", "NOISE_SIGMA": "8%", "SWEEP_BETA": "4,8"}
    variables = {"SMOOTH_BETA": "8", "KERNEL_TIME_STEP": "0.7", **parsed}
    output = run("config", **{f"BELTRAMI_{name}": value for name, value in variables.items()})
    assert in_force(output, "smooth", "beta") == (8.0, "BELTRAMI_SMOOTH_BETA")
    assert in_force(output, "smooth", "channels") == ("red,green", str(path))
    assert in_force(output, "smooth", "small") == (True, str(path))
    assert in_force(output, "smooth", "window") == (None, "")  # a default
    assert in_force(output, "kernel", "time-step") == (0.7, "BELTRAMI_KERNEL_TIME_STEP")
    assert in_force(output, "kernel", "threads") == (2, str(path))
    assert in_force(output, "render", "size")[0] == "80x60"
    assert in_force(output, "noise", "sigma")[0] == "8%"
    assert "# window = " in run("config", "smooth")

    again = tmp_path / "again.toml"  # what it says can be its input
    again.write_text(output)
    assert tomllib.loads(run("--config", again, "config")) == tomllib.loads(output)


@pytest.mark.slow
def test_a_batch_obeys_what_is_set_for_smooth(run, tmp_path):
    (tmp_path / "pyproject.toml").write_text(written({**QUICK, "beta": 3}, "tool.beltrami.smooth"))
    deeper = tmp_path / "deep" / "er"
    deeper.mkdir(parents=True)
    shutil.copy(NOISY, deeper / "a.ply")
    variables = {"BELTRAMI_SMOOTH_SPACE": "linear"}
    run("batch", "a.ply", "--out-dir", "out", cwd=deeper, **variables)
    run("smooth", "a.ply", "single.ply", cwd=deeper, **variables)
    assert (deeper / "out" / "a.ply").read_bytes() == (deeper / "single.ply").read_bytes()
    output = run("config", BELTRAMI_BATCH_SPACE="oklab", **variables)
    assert in_force(output, "batch", "space") == ("oklab", "BELTRAMI_BATCH_SPACE")
    assert in_force(output, "batch", "beta")[0] == 3.0
    assert in_force(output, "batch", "report") == (None, "")
    elsewhere = tmp_path / "named.toml"
    elsewhere.write_text(written({**QUICK, "report": '"r.json"'}))
    run("--config", elsewhere, "batch", "a.ply", "--out-dir", "named", cwd=deeper)
    assert (deeper / "named" / "batch.jsonl").exists()  # --report of smooth is of a single file


@pytest.mark.slow
def test_a_preset_beats_what_is_given_less_directly(run, tmp_path):
    (tmp_path / "beltrami.toml").write_text(written({"iterations": 3, "beta": 10}))
    run("smooth", NOISY, "preset.ply", "--preset", "paper")
    (tmp_path / "beltrami.toml").write_text("")
    run("smooth", NOISY, "paper.ply", "--preset", "paper", "--beta", 10)  # a preset says nothing of beta
    run("smooth", NOISY, "more.ply", "--preset", "paper", "--beta", 10, "-n", 3)
    assert (tmp_path / "preset.ply").read_bytes() == (tmp_path / "paper.ply").read_bytes()
    assert (tmp_path / "preset.ply").read_bytes() != (tmp_path / "more.ply").read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "words", "code"),
    [
        ("[smooth]\nbetta = 8", "betta is not an option of this command", 2),
        ("[smoth]\nbeta = 8", "there is no command smoth", 2),
        ("betta = 8", "betta is not an option of any command", 2),
        ('[smooth]\nbeta = "much"', "beta: 'much' is not a valid float", 2),
        ("[smooth]\nthreads = 0", "threads is 0, but must be between 1 and 1024", 2),
        ("[smooth]\ngutter = -1", "--gutter is -1, but must be", 2),
        ("[smooth]\nn = 3\niterations = 3", "given twice", 2),
        ("[smooth]\nbeta = ", "cannot be read", 3),
    ],
)
def test_faults_are_reported_with_the_file(text, words, code, run, tmp_path):
    path = tmp_path / "beltrami.toml"
    path.write_text(text)
    said = run("smooth", NOISY, "out.ply", code=code)
    assert words in said
    assert str(path) in said
    assert not (tmp_path / "out.ply").exists()


def test_flags_may_be_numbers_as_in_the_environment(run, tmp_path):
    (tmp_path / "beltrami.toml").write_text(written({"fast": 1}))
    assert in_force(run("config"), "smooth", "fast")[0] is True


@pytest.mark.parametrize("value", ["much", "-1", "nan"])
def test_a_bad_value_of_a_variable_is_refused_with_its_name(value, run):
    assert "BELTRAMI_SMOOTH_BETA" in run("smooth", NOISY, "out.ply", code=2, BELTRAMI_SMOOTH_BETA=value)


def test_denoise_is_smooth_with_what_is_configured_for_it(run, tmp_path):
    (tmp_path / "beltrami.toml").write_text("[smooth]\nn = 0\n")
    run("denoise", NOISY, "same.ply")
    assert (tmp_path / "same.ply").read_bytes() == NOISY.read_bytes()


def test_variables_for_other_things_do_no_harm(run):
    assert "Usage" in run("smooth", "--help", BELTRAMI_VERSION="1.0", BELTRAMI_HELP="me")
    assert "configuration file: none" in run("config", BELTRAMI_VERSION="1.0", BELTRAMI_HELP="me")


@pytest.mark.parametrize(
    ("name", "words", "said"),
    [
        ("BELTRAMI_SMOOTH_BTA", "smooth a.ply b.ply", "did you mean BELTRAMI_SMOOTH_BETA?"),
        ("BELTRAMI_SMOOTH_BTA", "batch a.ply --out-dir b", "did you mean BELTRAMI_SMOOTH_BETA?"),
        ("BELTRAMI_BATCH_JOB", "batch a.ply --out-dir b", "did you mean BELTRAMI_BATCH_JOBS?"),
        ("BELTRAMI_INFO_XYZZY", "info a.ply", "beltrami config info shows all options"),
        ("BELTRAMI_SMOOTH_BTA", "config smooth", "did you mean BELTRAMI_SMOOTH_BETA?"),
        ("BELTRAMI_BLENDER_EXTENSION_XYZZY", "blender-extension a.zip", "beltrami config blender-extension"),
    ],
)
def test_a_variable_that_is_misspelled_is_refused_as_in_a_file(name, words, said, tmp_path):
    line = refused(tmp_path, *words.split(), code=2, said=said, env={name: "8"})
    assert name in line
    beltrami("docs", "tuning", env={name: "8"})  # which has no such options
