"""A notice on other models in the output's folder that refer to a file which is replaced.

The heads of their files are searched for its name, and not parsed, so that a folder of large models takes little time.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from urllib.parse import quote

from beltrami_cli.formats.files.access import DEFAULT_ACCESS, read_regular
from beltrami_cli.formats.registry import OUTPUT_FORMATS, READ_ONLY

# Number of files of a folder that are searched.
_MAX_FILES = 1000
# Bytes of each file. OBJ and PLY list their files before the vertices; materials and the JSON of glTF are short,
# unless buffers are written into them.
_HEAD = 1 << 18


def shared_files(folder: Path, target: Path, names: Iterable[str]) -> list[str]:
    """Return a notice if models in a folder, other than the target, refer to existing files of these names."""
    replaced, heads = [name for name in names if os.path.lexists(folder / name)], dict[str, bytes]()
    if not replaced:
        return []
    files = list[str]()
    with contextlib.suppress(OSError), os.scandir(folder) as entries:  # some folders must not be listed
        files = sorted(entry.name for entry in entries if _may_refer(entry.name))
    for name in files[:_MAX_FILES]:
        with contextlib.suppress(OSError):
            heads[name] = read_regular(folder / name, DEFAULT_ACCESS, _HEAD)
    others = {target.name, *replaced}
    libraries = [name for name in _naming(heads, replaced) if name.endswith(".mtl") and name not in others]
    users = [name for name in _naming(heads, [*replaced, *libraries]) if name not in {*others, *libraries}]
    what = f"replaced {', '.join(replaced)}, which other models in the folder show, too"
    return [f"{what}: {', '.join(users)}."] if users else []


def _may_refer(name: str) -> bool:
    suffix = Path(name).suffix.lower().removeprefix(".")
    return suffix in (*OUTPUT_FORMATS, "mtl", *READ_ONLY)


def _naming(heads: Mapping[str, bytes], names: Iterable[str]) -> list[str]:
    """Return the files that contain one of some names as a whole word; in URIs they may be percent-encoded."""
    spelled = sorted({os.fsencode(each) for name in names for each in (name, quote(name))})
    named = re.compile(rb"(?:^|[\s\"'@>]|\./)(?:" + b"|".join(map(re.escape, spelled)) + rb")(?=$|[\s\"'@<])")
    # The expression alone takes 10 ms for the head of a binary file.
    holding = {name: head for name, head in heads.items() if any(each in head for each in spelled)}
    return [name for name, head in holding.items() if named.search(head)]
