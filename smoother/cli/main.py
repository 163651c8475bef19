"""The entry point: selects the command, and turns errors into a line and an exit code."""

import errno
import gc
import io
import sys
from collections.abc import Sequence
from pathlib import Path

import click

from smoother import threads
from smoother.cli.arguments import EXIT_DONE, EXIT_INTERRUPTED, EXIT_UNUSABLE
from smoother.cli.commands import COMMAND_NAMES, named_command
from smoother.cli.output import discard_output, warn
from smoother.cli.smoothing import smooth
from smoother.errors import SmootherError, UsageError

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # errors of a full disk


def main() -> None:
    """Run the command line and leave with its exit code.

    Libraries allocate a hundred thousand objects that are never garbage; collecting them repeatedly took a tenth of the
    time of smoothing a session.
    """
    threads.start_none()
    gc.set_threshold(300_000)  # allocated objects, three times those of the libraries, in place of the default of 700
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # for terminals without ±
    code = run(sys.argv[1:])
    gc.freeze()
    sys.exit(code)


def run(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit code; only bugs raise, with their traceback."""
    command, rest, name = choose(list(arguments) or ["--help"])
    try:
        _require_words(arguments)
        # as click's own `main` does, which would make a bug of a closed pipe
        with command.make_context(name, list(rest)) as context:
            return int(command.invoke(context) or EXIT_DONE)
    except click.exceptions.Exit as done:
        return done.exit_code
    except SmootherError as error:
        warn(str(error))
    except click.ClickException as error:
        warn(f"{error.format_message()} (see `{name} --help`)")
    except (click.Abort, KeyboardInterrupt) as error:
        warn(str(error) or "stopped")
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        discard_output(sys.stdout)  # keeps Python from complaining about it at exit
        return EXIT_DONE
    except OSError as error:
        if error.errno not in FULL or error.filename is not None:  # writers of named files raise errors of their own
            raise
        warn(f"what is printed cannot be written ({error.strerror})")
    return EXIT_UNUSABLE


def _require_words(arguments: Sequence[str]) -> None:
    """Raise UsageError for an empty argument, which as a path would be the current folder."""
    if "" in arguments:
        raise UsageError("an argument is empty; is a variable not set that should hold a name?")


def choose(arguments: list[str]) -> tuple[click.Command, list[str], str]:
    """Return the selected command, its arguments, and its name for messages.

    A path that exists is a session whatever its name, so `smooth demo` smooths ./demo when it is there. When more words
    follow, or options that only the command knows, the command is selected: `smooth check demo` checks ./demo.
    """
    word = arguments[0]
    if word not in COMMAND_NAMES:
        return smooth, arguments, "smooth"
    if Path(word).exists() and _is_lone_session(arguments):
        warn(f"{word} is here as a file or folder, so it is smoothed; with more words the command is meant")
        return smooth, arguments, "smooth"
    return named_command(word), arguments[1:], f"smooth {word}"


def _is_lone_session(arguments: list[str]) -> bool:
    """Whether the arguments are one session and options of the nameless command."""
    if "--help" in arguments:
        return False
    try:
        values, _, _ = smooth.make_parser(click.Context(smooth)).parse_args(list(arguments))
    except click.UsageError:
        return False
    return len(values["sessions"]) == 1
