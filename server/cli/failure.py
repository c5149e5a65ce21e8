"""Failures of commands, reported in one line on stderr, and signals that end commands."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO, Any

import click

from rosld.adapters.model import RosError


class Failure(click.ClickException):
    """Error that ends the command with exit code 1 and one line on stderr."""

    def __init__(self, sentence: str) -> None:
        super().__init__(" ".join(sentence.split()))

    def show(self, file: IO[Any] | None = None) -> None:
        """Write the line to stderr, or to `file`."""
        click.echo(f"rosld: {self.message}", file=file, err=file is None)


@contextmanager
def user_errors() -> Iterator[None]:
    """Turn a RosError, OSError or ValueError about a user's source, folder, address or file into a Failure."""
    try:
        yield
    except RosError as error:
        raise Failure(str(error)) from error
    except OSError as error:
        raise Failure(reason(error)) from error
    except ValueError as error:
        raise Failure(str(error)) from error


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
