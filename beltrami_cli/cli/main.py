"""The group of commands, and the way from exceptions to exit codes."""

from __future__ import annotations

import io
import os
import signal
import sys
import traceback
from typing import NoReturn

import click

from beltrami_cli.cli.command import complete_files, write_notes
from beltrami_cli.cli.console import printable
from beltrami_cli.cli.documentation import notes_on
from beltrami_cli.cli.interruption import Interruptible, Interruption
from beltrami_cli.cli.option_names import british_spelling, variable_behind
from beltrami_cli.cli.registry import COMMANDS, command_named
from beltrami_cli.cli.streams import ReaderGoneError, prepare_streams
from beltrami_cli.errors import BeltramiError, InputError
from beltrami_cli.signals import end_with_parent

_ALIASES = {"denoise": "smooth"}

_INTERRUPTED = "interrupted; files are as they were, or complete"


class LazyGroup(click.Group):
    """A group whose commands live in modules of their own, so that `--help` starts fast."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        return command_named(cmd_name) if cmd_name in COMMANDS else None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        write_notes(formatter, notes_on("All commands"))

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Resolve aliases; for an unknown name, suggest similar commands."""
        args = [_ALIASES.get(args[0], args[0]), *args[1:]]
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as error:
            from difflib import get_close_matches

            hint = ""
            if similar := get_close_matches(args[0], COMMANDS):
                hint = f" Did you mean {' or '.join(similar)}?"
            elif "." in args[0]:
                hint = f" To smooth a file: beltrami smooth {printable(args[0])} OUTPUT"
            raise click.UsageError(f"{error.message}{hint}", ctx) from None


@click.group(
    cls=LazyGroup,
    context_settings={
        "help_option_names": ["-h", "--help"],
        "max_content_width": 100,
        "token_normalize_func": british_spelling,
    },
)
@click.option(
    "--config",
    "config_path",
    envvar="BELTRAMI_CONFIG",
    metavar="FILE",
    shell_complete=complete_files,
    help="A TOML file with options.",
)
@click.version_option(None, "-V", "--version", package_name="beltrami-cli", prog_name="beltrami")
@click.pass_context
def group(context: click.Context, config_path: str | None) -> None:
    """Smooth the colours of 3-D meshes: on the surface itself, keeping edges."""
    from beltrami_cli.cli.configuration import configured_values, load

    context.obj = load(config_path)
    name = context.invoked_subcommand
    if name is not None:
        context.default_map = {name: configured_values(context.obj, name)}


def main() -> NoReturn:
    # OpenBLAS reserves some 30 MB a processor for products of large matrices, and this program computes none.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if os.environ.pop("BELTRAMI_PARENT", "") == str(os.getppid()):
        end_with_parent(os.getppid(), signal.SIGTERM)
    sys.exit(Interruptible().run(_run))


def _run() -> int:
    """Run the command line, print how it failed if it did, and return the exit code."""
    try:
        prepare_streams(hear_libraries=any(map(_verbosity, sys.argv[1:])))
        code = group.main(prog_name="beltrami", standalone_mode=False) or 0
        sys.stdout.flush()
        return code
    except Interruption as error:
        return _failure(error.exit_code, _INTERRUPTED)
    except click.Abort:
        return _failure(128 + signal.SIGINT, _INTERRUPTED)
    except click.ClickException as error:
        shown = io.StringIO()
        error.show(shown)
        for line in shown.getvalue().splitlines():
            click.echo(printable(line.expandtabs(4)), err=True)
        if isinstance(error, click.BadParameter) and (variable := variable_behind(error.param, error.ctx)):
            click.echo(f"The value is from the environment: {variable}", err=True)
        return error.exit_code
    except ReaderGoneError as error:
        return error.exit_code
    except BeltramiError as error:
        if _wants_traceback():
            traceback.print_exc()
        return _failure(error.exit_code, str(error))
    except MemoryError:
        return _failure(1, "there is not enough memory; use a smaller mesh or a machine with more")
    except Exception as error:
        return _unexpected(error)


def _unexpected(error: Exception) -> int:
    """Print an error of a kind that no module handles, in one line as well; return the exit code."""
    if Interruption.last is not None:
        return _failure(Interruption.last.exit_code, _INTERRUPTED)
    if _wants_traceback():
        traceback.print_exc()
    try:
        os.getcwd()  # noqa: PTH109
    except OSError:
        return _failure(InputError.exit_code, "the working folder was removed; change to one that exists")
    if isinstance(error, OSError) and isinstance(error.filename, str | bytes):
        cause = f"cannot be used ({error.strerror})"
        return _failure(InputError.exit_code, str(InputError(os.fsdecode(error.filename), cause)))
    cause = " ".join(f"{type(error).__name__}: {error}".split())
    return _failure(1, f"unexpected error: {cause}; run again with -vv and report it")


def _wants_traceback() -> bool:
    return sum(map(_verbosity, sys.argv[1:])) >= 2


def _verbosity(argument: str) -> int:
    """Count what an argument adds to --verbose; -v may stand in one word with other flags."""
    if argument.startswith("--"):
        return int(argument == "--verbose")
    return argument.count("v") if argument.startswith("-") and set(argument) <= set("-qv") else 0


def _failure(code: int, message: str) -> int:
    click.echo(f"beltrami: {printable(message)}", err=True)
    return code
