"""Whichever look at a file fails, as on a broken disk: exit code 3 or 4, a name, and old files as they were."""

import errno
import os

import pytest

from cli.commands import beltrami
from hostile.folders import snapshot
from hostile.textured_models import PICTURE, write_model

CALLS = ("stat", "lstat", "fstat", "open", "scandir", "listdir", "close", "readlink", "mkdir")
MAX_CALLS = 300
REAL_CLOSE = os.close
COMMANDS = {
    "info": "info model.obj --noise 9 -n 1 -t 1 --beta 8 --fast",  # chosen parameters take most of the time
    "sidecars": "noise model.obj out.obj --sigma 9 --overwrite",
    "in place": "noise model.obj model.obj --sigma 9 --overwrite",
    "picture": "noise skin.png out.jpg --sigma 9",
}


class Fault:
    """Lets the n-th call of a function fail that is about a file in a folder."""

    def __init__(self, patch, name, folder, code, at):
        self.calls, self.at, self.folder, self.code = 0, at, str(folder), code
        self.function = getattr(os, name)
        patch.setattr(os, name, self)

    def __call__(self, *arguments, **options):
        name = arguments[0] if arguments else "."
        if isinstance(name, int):
            try:
                name = os.path.realpath(f"/proc/self/fd/{name}")
            except OSError:
                name = ""
        path = os.path.join(self.folder, os.fspath(name))  # noqa: PTH118
        if path.startswith(self.folder):
            self.calls += 1
            if self.calls == self.at:
                if self.function is REAL_CLOSE:  # which closes a file in any case
                    self.function(*arguments)
                named = [each for each in arguments[:1] if not isinstance(each, int)]
                raise OSError(self.code, os.strerror(self.code), *map(str, named))
        return self.function(*arguments, **options)


@pytest.mark.slow  # some hundred runs
@pytest.mark.parametrize("call", CALLS)
@pytest.mark.parametrize("name", COMMANDS)
def test_a_look_at_a_file_that_fails(name, call, tmp_path, monkeypatch):
    for at in range(1, MAX_CALLS):
        folder = tmp_path / str(at)
        write_model(folder, "obj", "skin.png")
        (folder / "skin.png").write_bytes(PICTURE)
        before = snapshot(folder)
        with monkeypatch.context() as patch:
            patch.chdir(folder)
            fault = Fault(patch, call, folder, (errno.EIO, errno.EACCES)[at % 2], at)
            run = beltrami(*COMMANDS[name].split(), code=None, text=True)
        if run.returncode:
            assert run.returncode in (3, 4), run.stderr
            assert "unexpected" not in run.stderr
            assert any(each in run.stderr for each in (str(folder), "model", "skin", "out.")), run.stderr
            assert {path: each for path, each in snapshot(folder).items() if path in before} == before
        if fault.calls < at:
            assert run.returncode == 0
            return
    raise AssertionError("there are more calls than expected")
