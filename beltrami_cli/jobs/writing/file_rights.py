"""The permissions of a file that replaces another one: the same where the system allows it, and never more."""

from __future__ import annotations

import errno
import logging
import os
import stat
from pathlib import Path

LOG = logging.getLogger(__name__)
PRIVATE = 0o600
"""Mode of a new file until it gets the permissions of the replaced one."""

_OWNER = 0o700  # bits of a mode
# Prefixes of the extended attributes that are kept: of users, access control lists, and security labels.
_KEPT_ATTRIBUTES = ("user.", "system.", "security.selinux")
_ACCESS_LISTS = "system."


def take_over(old: Path, new: Path) -> None:
    """Copy owner, group, access control list, attributes and mode to a new file of mode `PRIVATE`.

    Where the group or the access list cannot be kept, others have the rights only that all of them had before.
    """
    before, mode = old.stat(), stat.S_IMODE(old.stat().st_mode)
    has_owner, has_group = _take_owner(before, new)
    if not has_owner:
        mode &= ~stat.S_ISUID
    if not has_group:
        shared = mode >> 3 & mode & 0o7
        mode = mode & (_OWNER | stat.S_ISUID | stat.S_ISVTX) | shared << 3 | shared
    if hasattr(os, "listxattr") and not _take_attributes(old, new, has_group=has_group):
        mode &= _OWNER
    new.chmod(mode)


def _take_owner(before: os.stat_result, new: Path) -> tuple[bool, bool]:
    """Copy owner and group; return for each whether it succeeded."""
    wanted = before.st_uid, before.st_gid
    # Without privileges a file may still change to another group of the user's.
    for user, group in (wanted, (-1, wanted[1])) if hasattr(os, "chown") else ():
        now = new.stat()
        if (now.st_uid, now.st_gid) == wanted:
            break
        try:
            os.chown(new, user, group)
        except OSError:
            continue
    now = new.stat()
    return now.st_uid == wanted[0], now.st_gid == wanted[1]


def _take_attributes(old: Path, new: Path, *, has_group: bool) -> bool:
    """Copy extended attributes; return whether both files have the same access control lists."""
    names, is_same = _attributes(old), True
    for name in _attributes(new) - names:  # inherited from the folder
        try:
            os.removexattr(new, name)
        except OSError:
            is_same &= not name.startswith(_ACCESS_LISTS)
    for name in sorted(names):
        is_list = name.startswith(_ACCESS_LISTS)
        if is_list and not has_group:  # its group entry would apply to another group
            is_same = False
            continue
        try:
            os.setxattr(new, name, os.getxattr(old, name))
        except OSError as error:
            is_same &= not is_list
            LOG.warning("the attribute %s of %s cannot be kept (%s)", name, old, error.strerror)
    return is_same


def _attributes(path: Path) -> set[str]:
    try:
        return {name for name in os.listxattr(path) if name.startswith(_KEPT_ATTRIBUTES)}
    except OSError as error:
        if error.errno in (errno.ENOTSUP, errno.ENOSYS):
            return set()
        raise
