"""Other models in the folder of an output that refer to a file which it replaces, such as the atlas of a kit.

The heads of their files are searched for its name, and not parsed, so that a folder of large models takes little time.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from itertools import islice
from pathlib import Path
from urllib.parse import quote

from beltrami_cli.formats.access import EVERYTHING_INSIDE, read_regular
from beltrami_cli.formats.registry import OUTPUT_FORMATS, held_images, is_only_read

_MOST_FILES = 1000
# Bytes of each file. OBJ and PLY name their files in front of the vertices; materials and the JSON of glTF are short,
# unless buffers are written into them.
_HEAD = 1 << 18
_MOST_NAMED = 3  # models in one line
_LIBRARY = ".mtl"


def shared_files(folder: Path, target: Path, names: Iterable[str]) -> list[str]:
    """Return a notice if models in a folder, other than the target, refer to existing files of these names."""
    replaced = [name for name in names if os.path.lexists(folder / name)]
    heads = _heads(folder, {target.name, *replaced}) if replaced else {}
    libraries = [name for name in heads if name.endswith(_LIBRARY) and _refers(heads[name], replaced)]
    users = [
        name
        for name in heads
        if not name.endswith(_LIBRARY) and _refers(heads[name], [*replaced, *libraries])
    ]
    if not users:
        return []
    more = f" and {len(users) - _MOST_NAMED} more" if len(users) > _MOST_NAMED else ""
    models = f"{', '.join(users[:_MOST_NAMED])}{more}"
    return [f"replaced {', '.join(replaced)}, which other models in the folder show, too: {models}."]


def _heads(folder: Path, left_out: set[str]) -> dict[str, bytes]:
    found = {}
    with os.scandir(folder) as entries:
        names = (entry.name for entry in entries if entry.name not in left_out)
        for name in sorted(islice(filter(_may_refer, names), _MOST_FILES)):
            try:
                found[name] = read_regular(folder / name, EVERYTHING_INSIDE, _HEAD)
            except OSError:
                continue
    return found


def _may_refer(name: str) -> bool:
    suffix = Path(name).suffix.lower().removeprefix(".")
    if suffix in OUTPUT_FORMATS:
        return held_images(OUTPUT_FORMATS[suffix]) is not None
    return f".{suffix}" == _LIBRARY or is_only_read(suffix)


def _refers(text: bytes, names: Iterable[str]) -> bool:
    """Whether a text names one of some files, as a whole word; URIs may have escapes."""
    spelled = {os.fsencode(each) for name in names for each in (name, quote(name))}
    words = b"|".join(map(re.escape, sorted(spelled)))
    return (
        bool(words) and re.search(rb"(?:^|[\s\"'@>]|\./)(?:" + words + rb")(?=$|[\s\"'@<])", text) is not None
    )
