"""`rosld cut`: the messages of a recording in a period, or around events, as recordings of their own."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import click

from rosld.adapters.base import AdapterOptions, Recording
from rosld.adapters.model import Encoding
from rosld.server.cli.failure import ExitCode, Failure, output_errors
from rosld.server.cli.info import open_recording
from rosld.server.cli.query import TIME_LIMIT, query_text, solutions
from rosld.server.cli.record import STDOUT, convert, mcap_file, require_format, require_pipe
from rosld.server.history.cut import CutRefused, Span, selected, write_cut
from rosld.server.history.recording_writer import RecordingWriter
from rosld.server.http.problem import Problem
from rosld.server.resources.recording_cut import cut_order_of, spans_of
from rosld.server.settings import Settings


def cut(
    path: str,
    output: Path,
    topics: Sequence[str],
    period: Mapping[str, str | None],
    around: Sequence[str],
    margins: tuple[float, float],
    options: AdapterOptions,
) -> None:
    """Cut out the messages between `from` and `to` of the period, or around times, queries or conditions.

    `margins` are the seconds before and after these. Raises Failure.
    """
    members: dict[str, object] = {
        "of": path,
        "topics": [*topics] or ["*"],
        "around": [query_text(each) for each in around],
        "before": margins[0],
        "after": margins[1],
    }
    with open_recording(path, options) as (recording, adapter):
        encoding = adapter.capabilities.encoding
        if output != STDOUT:
            require_format(output, encoding)
        try:
            order = cut_order_of({**members, **period})
            spans = asyncio.run(spans_of(order, recording, partial(_ask, path, options), lambda _: True))
            for target, span in zip(_targets(output, len(spans)), spans, strict=True):
                with output_errors():
                    writer = _write(recording, target, encoding, selected(order.selection.topics), span, options)
                click.echo(f"{target}: {writer.count} messages on {len(writer.counts)} topics", err=True)
        except CutRefused as error:
            raise Failure(str(error)) from error
        except Problem as problem:
            raise Failure(problem.detail, ExitCode.USAGE) from problem


async def _ask(path: str, options: AdapterOptions, text: str) -> Sequence[Sequence[str | None]]:
    """Return the columns of the results of a query. Raises Failure."""
    found = await solutions(path, text, Settings(types=options.types, query_time_limit=float(TIME_LIMIT)))
    rows = found["results"]["bindings"]
    return [[row[name]["value"] if name in row else None for row in rows] for name in found["head"]["vars"]]


def _write(
    recording: Recording,
    target: Path,
    encoding: Encoding,
    selects: Callable[[str], bool],
    span: Span,
    options: AdapterOptions,
) -> RecordingWriter:
    if target == STDOUT:
        return write_cut(recording, target, encoding, selects, span, sys.stdout.buffer)
    file = mcap_file(target)
    writer = write_cut(recording, file, encoding, selects, span)
    if file != target:
        try:
            convert(file, target, options)
        finally:
            file.unlink(missing_ok=True)
    return writer


def _targets(output: Path, count: int) -> Sequence[Path]:
    """Return the files to write: out-1.mcap, out-2.mcap … for several. Raises Failure if one exists."""
    if output == STDOUT:
        if count > 1:
            raise Failure(f"{count} events were found, and -o - is for one: name a file", ExitCode.USAGE)
        require_pipe()
        return [output]
    names = [output.with_name(f"{output.stem}-{number}{output.suffix}") for number in range(1, count + 1)]
    targets = names if count > 1 else [output]
    for each in targets:
        if each.exists() or mcap_file(each).exists():
            raise Failure(f"{each} already exists: choose another file", ExitCode.OUTPUT)
    return targets
