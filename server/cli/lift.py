"""`rosld lift`: convert a recording to one file of RDF in one pass; the file appears once it is complete."""

from __future__ import annotations

import contextlib
import gc
import gzip
import os
import signal
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, NoReturn, cast

import click
from msgspec import Struct

from rosld.adapters.base import AdapterOptions
from rosld.ontology.lift import LiftSettings
from rosld.ontology.syntax import Syntax
from rosld.ontology.urls import Space
from rosld.server.cli.failure import Failure, end_signals, user_errors
from rosld.server.cli.list_types import open_source
from rosld.server.cli.rdf_writer import Lifting, writer

SYNTAXES: Mapping[str, Syntax] = {
    ".nq": Syntax.N_QUADS,
    ".nt": Syntax.N_TRIPLES,
    ".ttl": Syntax.TURTLE,
    ".trig": Syntax.TRIG,
}
_COMPRESSION = 4
_BUFFER = 1 << 20
_STRIDE = 500
"""Number of messages between two updates of the progress bar."""


class Target(Struct, frozen=True):
    """The target of a lift: file, syntax, and compression."""

    path: Path
    syntax: Syntax
    compressed: bool


def target(path: Path) -> Target:
    """Return the target with a file's name. Raises ValueError for an unknown suffix."""
    compressed = path.suffix == ".gz"
    ending = (path.with_suffix("") if compressed else path).suffix
    if ending not in SYNTAXES:
        raise ValueError(f"{path}: the name must end in {', '.join(SYNTAXES)}, or one of these and .gz")
    return Target(path, SYNTAXES[ending], compressed)


def lift(recording: Path, output: Path, base: str, options: AdapterOptions, settings: LiftSettings) -> None:
    """Write a complete recording to `output`, with a progress bar on stderr. Raises Failure."""
    for number in end_signals():
        if number is not signal.SIGINT:
            signal.signal(number, _exit)  # an exception, so that the draft is removed
    with user_errors():
        to, space = target(output), Space(base, settings.types)
        with open_source(f"recording:{recording}", options) as adapter:
            for found in adapter.recordings.values():
                lifting = Lifting(found, space, settings, simulated_time=adapter.graph.simulated_time)
                write(lifting, to)
                _report_unread(lifting.unread)


def _exit(number: int, frame: object) -> NoReturn:
    sys.exit(128 + number)


def write(lifting: Lifting, to: Target) -> None:
    """Write the descriptions, then every message, with a progress bar on stderr."""
    gc.freeze()  # the garbage collector need not scan the loaded objects repeatedly
    to_bytes = writer(to.syntax, lifting)
    recording = lifting.recording
    with (
        draft_file(to) as file,
        click.progressbar(length=recording.count, label=recording.name, file=sys.stderr) as bar,
    ):
        for document in lifting.descriptions():
            file.write(to_bytes.document(document))
        for done, one in enumerate(lifting.messages(), 1):
            file.write(to_bytes.message(one))
            if done % _STRIDE == 0:
                bar.update(_STRIDE)
        bar.update(recording.count % _STRIDE)


@contextlib.contextmanager
def draft_file(to: Target) -> Iterator[IO[bytes]]:
    """Yield a temporary file next to the target, which replaces it at the end, or is removed after an exception.

    Raises Failure if the folder does not exist.
    """
    path = to.path.with_name(f".{to.path.name}.{os.getpid()}")
    try:
        with path.open("wb", _BUFFER) as file:
            if to.compressed:
                # mtime 0: the same recording gives the same bytes.
                with gzip.GzipFile(to.path.stem, "wb", _COMPRESSION, file, mtime=0) as compressed:
                    yield cast("IO[bytes]", compressed)
            else:
                yield file
            file.flush()
            os.fsync(file.fileno())
        path.replace(to.path)
    except FileNotFoundError as error:
        raise Failure(f"{to.path}: {error.strerror}") from error
    finally:
        path.unlink(missing_ok=True)


def _report_unread(unread: Counter[str]) -> None:
    for words, count in unread.most_common():
        click.echo(f"rosld: {count} messages are listed but could not be read: {words}", err=True)
