"""The items of a batch: a file each, with the options for all and its own."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from beltrami_cli.cli import options
from beltrami_cli.cli.option_names import options_by_name, values_for
from beltrami_cli.cli.parameter_options import record_from
from beltrami_cli.errors import UsageError
from beltrami_cli.fields import parameters
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.files.paths import is_file
from beltrami_cli.layers.settings import SmoothSettings

if TYPE_CHECKING:
    from beltrami_cli.batch.item import Item
    from beltrami_cli.batch.plan import Request

SHARED_WITH_SMOOTH = {*options.SMOOTHING, *options.UNWRAPPING, "columns"}
"""The options of `smooth` that change its result, which a manifest can give for each file."""


def items_for(requests: Iterable[Request], values: dict[str, Any], *, overwrite: bool) -> list[Item]:
    """Return the items of files; UsageError if the options of one are invalid."""
    common = _item_from(values)
    # What a preset takes the place of is not given.
    given = {name for name in SHARED_WITH_SMOOTH if options.is_given(name)}
    items = []
    for request in requests:
        try:
            item = item_with(request, values, given) if request.options else common
        except (click.UsageError, UsageError, ValueError) as error:
            cause = error.format_message() if isinstance(error, click.UsageError) else str(error)
            raise UsageError(f"{request.origin}: {cause}") from error
        item = replace(
            item, source=request.source, target=request.target, overwrite=overwrite,
            outside=values["allow_outside"], skip_uncoloured=values["skip_uncoloured"],
        )  # fmt: skip
        items.append(item)
    return items


def _item_from(values: dict[str, Any]) -> Item:
    """Return the item that the values of options describe, without its files."""
    from beltrami_cli.batch.item import Item

    columns = record_from(Access, values).columns
    return Item("", "", options.settings_from(values), options.unwrapping_from(values), columns=columns)


def item_with(request: Request, values: Mapping[str, Any], given: Collection[str]) -> Item:
    """Return the item of a file with options of its own, besides the `given` ones for all files."""
    command = click.get_current_context().command
    known = {n: each for n, each in options_by_name(command).items() if each.name in SHARED_WITH_SMOOTH}
    given_values = values_for(known, request.options)

    def next_to_manifest(name: str, *, may_be_other: bool) -> str:
        path = request.folder / name
        return name if may_be_other and not is_file(path) else str(path)

    for each in parameters(SmoothSettings, deep=True):
        if each.name in given_values:  # files are relative to the manifest; guides may be something else
            renamed = partial(next_to_manifest, may_be_other=each.repeatable)
            given_values[each.name] = each.with_files(given_values[each.name], renamed)
    with click.Context(command).scope() as context:
        context.params = {name: values[name] for name in SHARED_WITH_SMOOTH}
        for name in given:
            context.set_parameter_source(name, ParameterSource.DEFAULT_MAP)
        for name in given_values:  # overrides the options for all files, also with a preset
            context.set_parameter_source(name, ParameterSource.COMMANDLINE)
            context.params[name] = known[name].process_value(context, given_values[name])
        return _item_from(context.params)
