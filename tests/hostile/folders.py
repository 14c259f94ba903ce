"""Folders as they are on the disk, to be made and compared."""

import stat


def snapshot(folder):
    """Return the type, the mode and the content of everything in a folder, by relative path."""
    found = {}
    for path in sorted(folder.rglob("*")):
        status = path.lstat()
        if stat.S_ISLNK(status.st_mode):
            content = str(path.readlink()).encode()
        elif stat.S_ISREG(status.st_mode):
            content = path.read_bytes()
        else:
            content = b""
        found[str(path.relative_to(folder))] = status.st_mode, content
    return found


def write(folder, files):
    """Write bytes or text under relative names; return the folder."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder
