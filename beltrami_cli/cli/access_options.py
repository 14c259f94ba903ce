"""The options of files and messages, and what a job may read."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from beltrami_cli.formats.access import Access
from beltrami_cli.formats.registry import OUTPUT_FORMATS
from beltrami_cli.jobs.memory import limited_memory, memory_of_machine, parse_size
from beltrami_cli.samples.settings import IMAGE_FORMATS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from beltrami_cli.jobs.writing.output import Overwrite


def _size(context: click.Context, parameter: click.Parameter, text: str | None) -> int | None:
    if text is None:
        return None
    try:
        size = parse_size(text)
    except ValueError:
        raise click.BadParameter(f"{text!r} is no size such as 500M or 4G") from None
    if size == 0:
        raise click.BadParameter("nothing can be done in no memory")
    return size


overwrite = click.option(
    "--overwrite", is_flag=True, help="Replace OUTPUT, and the files beside it that it names, if they exist."
)
output_format = click.option(
    "--format", "output_format", type=click.Choice([*OUTPUT_FORMATS, *IMAGE_FORMATS]),
    help="Format of OUTPUT where its name does not tell, as with -.",
)  # fmt: skip
allow_outside = click.option(
    "--allow-outside", is_flag=True,
    help="Also read files that INPUT names beyond its own folder (absolute paths, '..', links). What OUTPUT needs of "
    "them anew goes into its own folder; nothing is written out there.",
)  # fmt: skip
max_memory = click.option(
    "--max-memory", callback=_size, metavar="SIZE",
    help="Take no more memory, such as 500M or 4G: smooth keeps textures that need more in files meanwhile, and all "
    "else that does is refused.  [default: what the machine has]",
)  # fmt: skip
quiet = click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors.")
verbose = click.option(
    "-v", "--verbose", count=True, help="Print what is done; twice: also where an error arose."
)


def overwrite_at(option: str, *, overwrite: bool) -> Overwrite:
    """Tell whether the file that an option names may be replaced.

    One that this program did not write may be only if the command line itself names it and says --overwrite.
    """
    sources = [click.get_current_context().get_parameter_source(name) for name in (option, "overwrite")]
    is_direct = all(source is ParameterSource.COMMANDLINE for source in sources)
    return "own" if overwrite and not is_direct else overwrite


def reading(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add all options that `reading_from` takes."""
    return allow_outside(max_memory(command))


@contextmanager
def reading_from(options: dict[str, Any], source: str) -> Iterator[Access]:
    """Give what a job on a file may read, and hold it to its memory, by the options that `reading` adds.

    Raises
    ------
    InputError
        If the job wants more memory.
    """
    size = options.pop("max_memory") or memory_of_machine()
    with limited_memory(size, source):
        yield Access(outside=options.pop("allow_outside"), memory=size)
