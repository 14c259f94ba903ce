"""Writes files that belong together again and again, ended by a signal at every one of its steps that touch files.

Run as a script with a folder, a signal, and the name of the output in the folder; the arguments of a command, which
writes it, may follow. For every step a child is forked, so that libraries are loaded once. After SIGKILL the same is
run again, which must come to the same end as if nothing had happened. Prints what was wrong, one line each, and the
number of steps last.
"""

import contextlib
import errno
import gc
import importlib
import os
import shutil
import signal
import sys
from pathlib import Path

from hostile.folders import snapshot

# What a process does to files, as its audit hooks see it.
STEPS = ("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.chmod", "os.link", "os.truncate")
MAX_STEPS = 200


class Ending:
    """Sends a signal to this process at its n-th step that touches files."""

    def __init__(self, at, number):
        self.at, self.number, self.steps = at, number, 0

    def __call__(self, event, arguments):
        flags = arguments[2] if event == "open" and isinstance(arguments[2], int) else 0
        writes = flags & (os.O_WRONLY | os.O_RDWR)
        if event in STEPS or (writes and str(arguments[0]) != os.devnull):
            self.steps += 1
            if self.steps == self.at:
                os.kill(os.getpid(), self.number)


def no_link(*_, **__):
    raise PermissionError(errno.EPERM, "Operation not permitted")


def child(target, at, number, arguments, loaded):
    """Be a command that by default writes an OBJ file of three; exit with 77 if it did before the step was reached.

    The modules that it loaded are written to a file, if one is given.
    """
    from beltrami_cli.cli import main as command
    from beltrami_cli.formats.changes import Written
    from beltrami_cli.jobs.writing.output import Output
    from beltrami_cli.jobs.writing.sidecars import SidecarNames

    def job(**_):
        output = Output(target, overwrite=True)
        sidecars = {"maps.mtl": b"new", "maps/skin.png": b"new"}
        output.write(
            Written([b"new ", b"model"], sidecars), SidecarNames(output.folder, lambda: frozenset(sidecars))
        )
        return 0

    if "NO_LINKS" in os.environ:  # as on FAT
        os.link = no_link
    if arguments:
        sys.argv = ["beltrami", *arguments]
    else:
        command.group.main = job
    if number != signal.SIGKILL:
        signal.signal(number, signal.SIG_DFL)  # who started the tests may not want to hear it, as with nohup
    ending = Ending(at, number)
    sys.addaudithook(ending)
    code = 1
    try:
        command.main()
    except SystemExit as stop:
        code = int(stop.code or 0)
    finally:
        if loaded:
            loaded.write_text("\n".join(sys.modules))
        os._exit(77 if ending.steps < at and code == 0 else code)


def faults(before, after, finished, number):
    """Return what a signal must not leave: files that are neither old nor new, some of each, or anything else."""
    found = []
    for path, content in before.items():
        if after.get(path) not in (content, finished[path]):
            found.append(f"{path} is neither old nor new")
    if number == signal.SIGKILL:  # which leaves no time to clean up, but still must not harm
        new = set(after) - set(finished) - set(before)
        found += [f"{path} is left over" for path in sorted(new) if not path.endswith(".tmp")]
    elif after not in (before, finished):
        changes = [path for path in after if after[path] != before.get(path)]
        found.append(f"not all is old, nor all new: changed are {', '.join(changes)}")
    return found


def run(folder, target, at, number, arguments, loaded=None):
    """Fork, and return how the child ended."""
    pid = os.fork()
    if pid == 0:
        os.chdir(folder)
        child(target, at, number, arguments, loaded)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def load(modules):
    """Load modules once for all children; to load them takes longer than what a child does with them."""
    for name in modules:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    gc.freeze()  # so that no child copies pages in which nothing changes but marks of its collector


def comparable(folder):
    """Return a snapshot without what reports say, in which times differ from run to run."""
    found = snapshot(folder)
    return {path: (mode, "report.json" not in path and content) for path, (mode, content) in found.items()}


def main(source, target, number, arguments):
    """Try every step."""
    work = source.parent / "work"

    def fresh():
        shutil.rmtree(work, ignore_errors=True)
        shutil.copytree(source, work)

    fresh()
    before = comparable(work)
    modules = source.parent / "modules"
    if run(work, target, MAX_STEPS, number, arguments, modules) != 77:
        print("without a signal it fails")
    finished = comparable(work)
    load(modules.read_text().split())
    for at in range(1, MAX_STEPS):
        fresh()
        code = run(work, target, at, number, arguments)
        for fault in faults(before, comparable(work), finished, number):
            print(f"step {at}: {fault}")
        if code == 77:
            print(at - 1)
            return
        if number == signal.SIGKILL:
            is_complete = finished.items() <= comparable(work).items()
            again = run(work, target, MAX_STEPS, number, arguments)
            if comparable(work) != finished or (again != 77 and not is_complete):
                print(f"step {at}: again, it ends with {again} and leaves {sorted(comparable(work))}")
        if code not in (128 + number, -signal.SIGKILL):
            print(f"step {at}: exit code {code}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[3], int(sys.argv[2]), sys.argv[4:])
