"""Parameters as fields of records: each is declared once, with its default, range or choices, unit and help.

The options of the command line are made from the fields, and with them configuration files, variables of the
environment and manifests; so are the checks of ranges, overrides by keywords in Python, the attributes in the records'
docstrings, and the table of `beltrami docs parameters`.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Collection, Iterable, Iterator
from functools import cache
from numbers import Integral, Real
from typing import Any, TypeVar

from beltrami_cli.errors import UsageError

Record = TypeVar("Record")

REQUIRED = dataclasses.MISSING  # as a default


_PARAMETER, _PART = "parameter", "part"
_TYPES: dict[type, tuple[type, ...]] = {int: (Integral,), float: (Real,), str: (str, os.PathLike)}
_NOUNS = {bool: "True or False", int: "a whole number", float: "a number", str: "text"}


@dataclasses.dataclass(frozen=True)
class Parameter:
    """The declaration of a parameter: which values it can have, and its option."""

    name: str
    default: Any
    help: str
    kind: type  # of the value; where there are several, of each
    several: bool = False  # whether it is a tuple
    optional: bool = False  # whether it may be None
    choices: tuple[str, ...] = ()
    low: float | None = None
    high: float | None = None
    is_open: bool = False  # whether `low` and `high` themselves are excluded
    is_odd: bool = False
    also: tuple[float, ...] = ()  # values allowed outside the range
    allowed: str = ""  # in words, where the record checks it by itself
    unit: str = ""
    unset: str = ""  # behaviour without a value, if it differs from the default
    group: str = ""  # of options in the help: the `group` of the record
    is_file: bool = False  # names files that are read
    # Returns the file at the end of a value that may name one, or "".
    file_in: Callable[[str], str] | None = None
    lifts_limit: bool = False
    of: tuple[str, ...] = ()  # the kinds of input that it has an effect on; empty: all
    # Spellings of the option, and click's name of it if that differs; empty: there is none.
    flags: tuple[str, ...] = ()
    metavar: str | None = None
    repeatable: bool = False  # whether the option of several values is given once for each
    # Makes the value from the text of the option; ValueError names the fault.
    parse: Callable[[str], Any] | None = None
    show: Callable[[Any], str] = str  # makes that text from the value
    words: tuple[str, ...] = ()  # texts that `parse` takes, for completion
    is_daily: bool = False  # shown by --help; all others by --help-all only, under their group

    @property
    def flag(self) -> str:
        """The option as users know it."""
        return next((each for each in self.flags if each.startswith("--")), self.flags[0])

    def is_deliberate(self, value: Any) -> bool:
        """Whether only users may set it to a value, and no configuration file that was merely found."""
        return self.is_file or self.lifts_limit or bool(self.files(value))

    @property
    def range(self) -> str:
        """What a value must be, in words."""
        if self.allowed:
            return self.allowed
        if self.choices:
            return _enumerated(self.choices)
        if self.kind not in (int, float):
            return _NOUNS.get(self.kind, "")
        text = f"odd, and {self._interval()}" if self.is_odd else self._interval()
        return f"{', '.join(map(str, self.also))}, or {text}" if self.also else text

    @property
    def default_in_words(self) -> str:
        """What holds where nothing is given; empty if that is nothing."""
        if self.unset:
            return self.unset.format(default=self.default)
        if self.kind is bool and "/" in self.flags[0]:
            yes, no = self.flags[0].replace("--", "").split("/")
            return yes if self.default else no
        if self.kind is bool or self.default in (None, (), REQUIRED):
            return ""
        return self.show(self.default)

    def files(self, value: Any) -> list[str]:
        if value is None or not (self.is_file or self.file_in):
            return []
        texts = list(map(str, value if isinstance(value, tuple) else [value]))
        return texts if self.file_in is None else list(filter(None, map(self.file_in, texts)))

    def with_files(self, value: Any, renamed: Callable[[str], str]) -> Any:
        """Return a value that names other files."""
        if isinstance(value, tuple):
            return tuple(self.with_files(each, renamed) for each in value)
        for name in self.files(value):
            value = str(value).removesuffix(name) + renamed(name)
        return value

    def check(self, value: Any) -> None:
        if value is None and self.optional:
            return
        if self.several and not isinstance(value, (tuple, list)):
            raise UsageError(f"{self.name} is of type {type(value).__name__}, but must be a tuple")
        for each in value if isinstance(value, (tuple, list)) and self.several else (value,):
            fault = self._fault(each)
            if fault:
                name = f"one of {self.name}" if self.several else self.name
                shown = each if isinstance(each, (str, int, float)) else f"of type {type(each).__name__}"
                raise UsageError(f"{name} is {shown}, but must be {fault}")

    def _fault(self, value: Any) -> str:
        """Return what a value would have to be; empty if it is as it must be."""
        types = _TYPES.get(self.kind, (self.kind,))
        if not isinstance(value, types) or (isinstance(value, bool) and self.kind is not bool):
            return self.range if self.choices or self.allowed else _NOUNS.get(self.kind, self.kind.__name__)
        if self.choices:
            return "" if value in self.choices else self.range
        return "" if self.kind not in (int, float) or self._is_within(value) else self.range

    def _is_within(self, value: Any) -> bool:
        if value in self.also:
            return True
        try:
            is_finite = math.isfinite(value)
        except OverflowError:  # a whole number beyond all floats
            return False
        if not is_finite or (self.is_odd and value % 2 != 1):
            return False
        low = -math.inf if self.low is None else self.low
        high = math.inf if self.high is None else self.high
        return bool(low < value < high if self.is_open else low <= value <= high)

    def _interval(self) -> str:
        if self.low is None and self.high is None:
            return "a finite number" if self.kind is float else "a whole number"
        if self.high is None:
            positive = self.is_open and self.low == 0
            return "a positive number" if positive else f"{self.low} or more"
        if self.low is None:
            return f"{self.high} or less"
        return f"between {self.low} and {self.high}" + (", both excluded" if self.is_open else "")


def parameter(default: Any, meaning: str, **details: Any) -> Any:
    """Declare a field of a record as a parameter; the details are attributes of `Parameter`.

    `flags`: by default from the name of the field.
    """
    several = isinstance(default, tuple)
    sample = default[0] if several and default else None if several else default
    kind = str if sample is None else type(sample)
    guessed = {"kind": kind, "several": several, "optional": default is None, "flags": None}
    # The name is known only when the class is made, see `parameters`.
    declared = Parameter("", default, meaning, **{**guessed, **details})
    return dataclasses.field(default=default, metadata={_PARAMETER: declared})


def part(record: type[Record], make: Callable[[], Record] | None = None) -> Any:
    """Declare a field of a record as a record with parameters of its own."""
    return dataclasses.field(default_factory=make or record, metadata={_PART: record})


def parameters(record: Any, *, deep: bool = False) -> tuple[Parameter, ...]:
    """Return the parameters of a record, or its class, in order; deep: with the parameters of nested records."""
    return _parameters_of(record if isinstance(record, type) else type(record), deep)


@cache
def _parameters_of(record: type, deep: bool) -> tuple[Parameter, ...]:
    collected: list[Parameter] = []
    for each in dataclasses.fields(record):
        if _PARAMETER in each.metadata:
            declared, group = each.metadata[_PARAMETER], getattr(record, "group", "")
            flags = (f"--{each.name.replace('_', '-')}",) if declared.flags is None else declared.flags
            collected.append(dataclasses.replace(declared, name=each.name, group=group, flags=flags))
        elif deep and _PART in each.metadata:
            collected += _parameters_of(each.metadata[_PART], deep)
    return tuple(collected)


def given_parameters(record: object) -> list[Parameter]:
    """Return the parameters of a record, and of the records in it, that are not as by default."""
    changed = [each for each in parameters(record) if getattr(record, each.name) != each.default]
    return [*changed, *(each for name in parts(record) for each in given_parameters(getattr(record, name)))]


def without_effect(declared: Iterable[Parameter], kinds: Collection[str]) -> list[Parameter]:
    return [each for each in declared if each.of and not {*each.of} & {*kinds}]


def require_effect(given: Iterable[Parameter], kinds: Collection[str], name: str) -> None:
    """Raise UsageError if a given parameter has no effect on an input of some kinds."""
    for each in without_effect(given, kinds):
        cause = f"{each.flag} has no effect on {' and '.join(kinds)}, only on {' and '.join(each.of)}"
        raise UsageError(f"{cause}; leave it out", name)


def parts(record: Any) -> dict[str, type]:
    return {each.name: each.metadata[_PART] for each in dataclasses.fields(record) if _PART in each.metadata}


def named_files(record: Any) -> Iterator[str]:
    """Give what parameters of a record, and of records in it, name as files to read."""
    for each in dataclasses.fields(record):
        value = getattr(record, each.name)
        if _PART in each.metadata:
            yield from named_files(value)
        elif _PARAMETER in each.metadata:
            yield from each.metadata[_PARAMETER].files(value)


def with_files(record: Record, renamed: Callable[[str], str]) -> Record:
    """Return a record whose parameters, nested ones included, name other files."""
    changed: dict[str, Any] = {name: with_files(getattr(record, name), renamed) for name in parts(record)}
    for each in parameters(record):
        changed[each.name] = each.with_files(getattr(record, each.name), renamed)
    changed = {name: value for name, value in changed.items() if value != getattr(record, name)}
    return dataclasses.replace(record, **changed) if changed else record  # type: ignore[type-var]


class Checked:
    """A record whose parameters are checked as it is made."""

    def __post_init__(self) -> None:
        for each in parameters(self):
            each.check(getattr(self, each.name))


def override(record: Record, **values: Any) -> Record:
    """Return a record with other values of parameters in it, or in records in it; UsageError if it cannot have them."""
    known = {each.name for each in parameters(record, deep=True)}
    for name in values:
        if name not in known:
            raise UsageError(f"there is no parameter {name}{_suggestion(name, known)}")
    changed = {each.name: values[each.name] for each in parameters(record) if each.name in values}
    for name, kind in parts(record).items():
        nested = {each.name: values[each.name] for each in parameters(kind, deep=True) if each.name in values}
        if nested:
            changed[name] = override(getattr(record, name), **nested)
    if hasattr(record, "with_values"):  # which depend on each other
        return record.with_values(**changed)  # type: ignore[no-any-return]
    return dataclasses.replace(record, **changed)  # type: ignore[type-var]


class _Docstring:
    """A docstring to which the parameters of its class are added when it is read."""

    def __init__(self, text: str) -> None:
        self._text = text

    def __get__(self, instance: object, record: type) -> str:
        import inspect
        import textwrap

        lines = [inspect.cleandoc(self._text), "", "Attributes", "----------"]
        for each in parameters(record):
            lines.append(f"{each.name} : {_type_in_words(each)}")
            meaning = f"{each.help} In {each.unit}." if each.unit else each.help
            lines += textwrap.wrap(meaning, 110, initial_indent="    ", subsequent_indent="    ")
        lines += [f"{name} : {kind.__name__}" for name, kind in parts(record).items()]
        lines += ["", "Raises", "------", "UsageError"]
        lines.append("    If a value is out of its range, or two contradict each other.")
        return "\n".join([*lines, ""])


def described(record: type[Record]) -> type[Record]:
    """Have the parameters of a record in its docstring, as numpydoc has attributes."""
    record.__doc__ = _Docstring(record.__doc__ or "")  # type: ignore[assignment]
    return record


def _type_in_words(declared: Parameter) -> str:
    text = declared.kind.__name__
    if declared.several:
        text = f"tuple of {text}"
    elif declared.choices:
        text = "{" + ", ".join(f'"{choice}"' for choice in declared.choices) + "}"
    text += " or None" if declared.optional else ""
    return text if declared.default is REQUIRED else f"{text}, default {declared.default!r}"


def _enumerated(words: tuple[str, ...]) -> str:
    return " or ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def _suggestion(name: str, known: set[str]) -> str:
    from difflib import get_close_matches

    similar = get_close_matches(name, sorted(known))
    return f"; did you mean {_enumerated(tuple(similar))}?" if similar else ""
