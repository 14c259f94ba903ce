"""A file that is replaced keeps owner, group, access list and attributes; nobody gains rights where it cannot."""

import contextlib
import errno
import os
import stat
import struct

import pytest

from beltrami_cli.errors import OutputError
from beltrami_cli.formats.changes import Written
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.jobs.writing.sidecars import SidecarNames
from hostile.users import acting_as, let_others_pass

pytestmark = pytest.mark.skipif(
    not hasattr(os, "setxattr") or os.geteuid() != 0, reason="only root can act for several users"
)
LIST, FOLDER_LIST = "system.posix_acl_access", "system.posix_acl_default"
OWNER, GROUP, NAMED, MEMBER, NOBODY = 12001, 12002, 12003, 12004, 12005
# User and groups of processes.
PEOPLE = {
    "owner": (OWNER, [12101]), "member": (MEMBER, [GROUP]), "named": (NAMED, [12103]), "other": (NOBODY, [12105]),
    "member of the writer's group": (NOBODY, [12106]),
}  # fmt: skip
WRITER = (OWNER, [12106])  # in no group of the file
_UNDEFINED = 0xFFFFFFFF


def access_list(owner, group, mask, other, **named):
    """Return a list as Linux stores it: version 2, then kind, rights and identifier of each entry."""
    entries = [(1, owner, _UNDEFINED), (2, named["user"], NAMED), (4, group, _UNDEFINED)]
    entries += [(0x10, mask, _UNDEFINED), (0x20, other, _UNDEFINED)]
    return struct.pack("<I", 2) + b"".join(struct.pack("<HHI", *entry) for entry in entries)


LISTS = {
    "none": None,
    "the group may do nothing": access_list(6, 0, 6, 4, user=6),
    "one user may do nothing": access_list(6, 6, 6, 6, user=0),
}


def may_open(path, flag):
    with contextlib.suppress(PermissionError):
        os.close(os.open(path, flag))
        return True
    return False


def rights(path):
    """Return who may read and write a file."""
    allowed = set()
    for name, person in PEOPLE.items():
        with acting_as(*person):
            allowed |= {(name, flag) for flag in (os.O_RDONLY, os.O_WRONLY) if may_open(path, flag)}
    return allowed


def write(folder, sidecars):
    output = Output(str(folder / "out.obj"), overwrite=True)
    output.write(Written([b"new"], sidecars), SidecarNames(folder, lambda: frozenset(sidecars)))


def shared_folder(tmp_path, *, mode=0o640, entries=None, inherited=None):
    """Return a folder of the file's owner, which all may look into, with an OUTPUT of certain rights."""
    let_others_pass(tmp_path)
    folder = tmp_path / "folder"
    folder.mkdir(mode=0o755)
    target = folder / "out.obj"
    target.write_text("old")
    target.chmod(mode)
    for path in (folder, target):
        os.chown(path, OWNER, GROUP)
    try:
        os.setxattr(target, "user.note", b"of mine")
        if entries is not None:
            os.setxattr(target, LIST, entries)
        if inherited is not None:
            os.setxattr(folder, FOLDER_LIST, inherited)
    except OSError as error:
        if error.errno != errno.ENOTSUP:
            raise
        pytest.skip("this file system has no attributes")
    return folder, target


def attributes(path):
    return {name: os.getxattr(path, name) for name in os.listxattr(path)}


@pytest.mark.parametrize("sidecars", [{}, {"a.png": b"new"}])
@pytest.mark.parametrize("entries", LISTS.values(), ids=LISTS)
def test_owner_access_list_and_attributes_are_kept(entries, sidecars, tmp_path):
    folder, target = shared_folder(tmp_path, entries=entries, inherited=access_list(6, 6, 6, 6, user=6))
    before, had, kept = target.stat(), rights(target), attributes(target)
    write(folder, sidecars)
    after = target.stat()
    assert target.read_bytes() == b"new"
    assert (after.st_uid, after.st_gid, after.st_mode) == (before.st_uid, before.st_gid, before.st_mode)
    assert attributes(target) == kept
    assert rights(target) == had


@pytest.mark.parametrize("mode", [0o640, 0o664, 0o604, 0o606, 0o6777])
@pytest.mark.parametrize("entries", LISTS.values(), ids=LISTS)
@pytest.mark.parametrize("inherited", [None, access_list(6, 6, 6, 6, user=6)])
def test_nobody_gains_rights_where_the_group_cannot_be_kept(mode, entries, inherited, tmp_path):
    folder, target = shared_folder(tmp_path, mode=mode, entries=entries, inherited=inherited)
    had = rights(target)
    with acting_as(*WRITER):
        write(folder, {})
    assert target.read_bytes() == b"new"
    assert target.stat().st_gid == WRITER[1][0]
    assert rights(target) <= had
    assert target.stat().st_mode & stat.S_ISGID == 0
    assert os.getxattr(target, "user.note") == b"of mine"


@pytest.mark.parametrize("call", ["setxattr", "removexattr", "chown"])
@pytest.mark.parametrize("entries", LISTS.values(), ids=LISTS)
def test_nobody_gains_rights_where_the_system_refuses(call, entries, tmp_path, monkeypatch):
    folder, target = shared_folder(tmp_path, entries=entries, inherited=access_list(6, 6, 6, 6, user=6))
    had = rights(target)

    def refuse(*_):
        raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

    monkeypatch.setattr(os, call, refuse)
    write(folder, {})
    assert target.read_bytes() == b"new"
    assert rights(target) <= had


def test_a_set_that_is_undone_has_all_that_it_had(tmp_path, monkeypatch):
    """Also where no file can have two names, so that the old one is copied."""
    folder, target = shared_folder(tmp_path, entries=LISTS["the group may do nothing"])
    image = folder / "a.png"
    image.write_text("old")
    before, kept = target.stat(), attributes(target)

    def refuse(*_, **__):
        raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

    def fail(descriptor, data, write=os.write):
        if data == b"true\n":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(descriptor, data)

    monkeypatch.setattr(os, "link", refuse)
    monkeypatch.setattr(os, "write", fail)
    with pytest.raises(OutputError):
        write(folder, {"a.png": b"new"})
    after = target.stat()
    assert target.read_text() == image.read_text() == "old"
    assert (after.st_uid, after.st_gid, after.st_mode) == (before.st_uid, before.st_gid, before.st_mode)
    assert after.st_mtime_ns == before.st_mtime_ns
    assert attributes(target) == kept
