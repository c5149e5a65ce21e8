"""Failures of commands, reported in one line on stderr, their exit codes, and signals that end commands."""

from __future__ import annotations

import errno
import logging
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum
from typing import IO, Any

import click

from rosld.adapters.model import NotFound, RosError, TimedOut, Unreachable, Unreadable


class ExitCode(IntEnum):
    """Exit codes of commands."""

    FAILED = 1
    USAGE = 2
    INPUT = 3
    UNREACHABLE = 4
    OUTPUT = 5
    INCOMPLETE = 6
    INTERRUPTED = 130


@contextmanager
def only_errors(logger: str = "rosld") -> Iterator[None]:
    """Log only errors meanwhile: of what is less, the command itself prints what matters."""
    log = logging.getLogger(logger)
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(level)


EXIT_CODES = """\b
Exit codes:
  0    done
  1    any other failure
  2    wrong usage: an option, a name, a query
  3    an input is missing or cannot be read
  4    the robot or the server cannot be reached
  5    the output cannot be written
  6    the result is incomplete
  130  interrupted (Ctrl-C)
"""
_OF_ROBOTS: tuple[tuple[type[RosError], ExitCode], ...] = (
    (NotFound, ExitCode.INPUT),
    (Unreadable, ExitCode.INPUT),
    (Unreachable, ExitCode.UNREACHABLE),
    (TimedOut, ExitCode.UNREACHABLE),
)
_OF_INPUT = frozenset({errno.ENOENT, errno.EISDIR, errno.ENOTDIR, errno.EIO})
_OF_OUTPUT = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG})


class Failure(click.ClickException):
    """Error that ends the command with an exit code and one line on stderr."""

    def __init__(self, sentence: str, code: ExitCode = ExitCode.FAILED) -> None:
        super().__init__(" ".join(sentence.split()))
        object.__setattr__(self, "exit_code", int(code))  # click declares it for classes only

    def show(self, file: IO[Any] | None = None) -> None:
        """Write the line to stderr, or to `file`."""
        head = click.style("rosld:", fg="red", bold=True)
        click.echo(f"{head} {self.message}", file=file, err=file is None, color=self.show_color)


class CommandGroup(click.Group):
    """Group of commands that exit with 130 on Ctrl-C, and write no colours if NO_COLOR is set."""

    def make_context(self, *arguments: Any, **options: Any) -> click.Context:
        if os.environ.get("NO_COLOR"):
            options.setdefault("color", False)
        return super().make_context(*arguments, **options)

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            click.echo("rosld: interrupted", err=True)
            ctx.exit(ExitCode.INTERRUPTED)


@contextmanager
def user_errors(values: ExitCode = ExitCode.FAILED) -> Iterator[None]:
    """Turn a RosError, OSError or ValueError about a user's source, folder, address or file into a Failure.

    `values` is the exit code of ValueErrors.
    """
    try:
        yield
    except RosError as error:
        raise Failure(str(error), code_of(error)) from error
    except OSError as error:
        raise Failure(reason(error), _code_of_os(error)) from error
    except ValueError as error:
        raise Failure(str(error), values) from error


@contextmanager
def output_errors() -> Iterator[None]:
    """Turn an OSError of writing the output into a Failure."""
    try:
        yield
    except OSError as error:
        raise Failure(f"the output cannot be written: {reason(error)}", ExitCode.OUTPUT) from error


def code_of(error: RosError) -> ExitCode:
    """Return the exit code for an error of an adapter."""
    return next((code for kind, code in _OF_ROBOTS if isinstance(error, kind)), ExitCode.FAILED)


def _code_of_os(error: OSError) -> ExitCode:
    if error.errno in _OF_OUTPUT:
        return ExitCode.OUTPUT
    return ExitCode.INPUT if error.errno in _OF_INPUT else ExitCode.FAILED


def reason(error: OSError) -> str:
    """Return the message of an OSError, after the name of its file if it has one."""
    words = error.strerror or str(error) or type(error).__name__
    return f"{error.filename}: {words}" if error.filename else words


_END = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)


def end_signals() -> tuple[signal.Signals, ...]:
    """Return the signals that end a command in an orderly way.

    SIGHUP is left out if it is already ignored, as with `nohup`.
    """
    return tuple(one for one in _END if one != signal.SIGHUP or signal.getsignal(one) is not signal.SIG_IGN)
