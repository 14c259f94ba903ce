"""This process in the name of other users, which only root can do."""

import contextlib
import os


@contextlib.contextmanager
def acting_as(user, groups):
    """Have this process do what another user may do; a process of theirs for each look would take most of the time."""
    before = os.getegid(), os.getgroups()
    os.setgroups(groups)
    os.setegid(groups[0])
    os.seteuid(user)
    try:
        yield
    finally:
        os.seteuid(0)
        os.setegid(before[0])
        os.setgroups(before[1])


def let_others_pass(folder):
    """Let other users reach a folder of pytest, which keeps them out."""
    for path in (folder, *folder.parents):
        if path.stat().st_mode & 0o077 == 0:
            path.chmod(0o711)
