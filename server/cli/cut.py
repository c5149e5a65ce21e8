"""`rosld cut`: the messages of a recording in a period, or around events, as recordings of their own."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import click

from rosld.adapters.base import FOR_EVER, AdapterOptions, Recording
from rosld.adapters.model import Encoding
from rosld.adapters.model.moment import parse_moment
from rosld.ontology.literals import date_time_nanoseconds
from rosld.server.cli.failure import ExitCode, Failure, output_errors, user_errors
from rosld.server.cli.info import open_recording
from rosld.server.cli.query import query_text, solutions
from rosld.server.cli.record import STDOUT, convert, mcap_file, require_format, require_pipe
from rosld.server.history.cut import CutRefused, Span, selected, spans_around, write_cut
from rosld.server.history.recording_writer import RecordingWriter
from rosld.server.resources.number_conditions import ConditionReader, parse_condition
from rosld.server.settings import Settings, check_topic_glob

_QUERY = re.compile(r"\bSELECT\b", re.IGNORECASE)


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
    with user_errors(ExitCode.USAGE):
        for glob in topics:
            check_topic_glob("--topic", glob)
    with open_recording(path, options) as (recording, adapter):
        encoding = adapter.capabilities.encoding
        if output != STDOUT:
            require_format(output, encoding)
        try:
            spans: Sequence[Span] = [_span(recording, period)]
            if around:
                times = [time for each in around for time in _times(path, recording, each, options)]
                first, last = spans[0]
                spans = spans_around([time for time in times if first <= time <= last], *margins)
            for target, span in zip(_targets(output, len(spans)), spans, strict=True):
                with output_errors():
                    writer = _write(recording, target, encoding, selected(topics), span, options)
                click.echo(f"{target}: {writer.count} messages on {len(writer.counts)} topics", err=True)
        except CutRefused as error:
            raise Failure(str(error)) from error


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


def _span(recording: Recording, period: Mapping[str, str | None]) -> Span:
    """Return the times of a period. Raises ValueError."""
    times = {name: parse_moment(f"--{name}", text) for name, text in period.items() if text is not None}
    bounds = recording.start_ns, recording.end_ns
    first = times["from"].at(*bounds) if "from" in times else bounds[0]
    last = times["to"].at(*bounds) if "to" in times else FOR_EVER
    if first > last:
        raise CutRefused(f"--from {period['from']} is after --to {period['to']}")
    return Span(first, last)


def _times(path: str, recording: Recording, text: str, options: AdapterOptions) -> Sequence[int]:
    """Return the times in ns that a query finds, at which a condition becomes true, or that the text says."""
    exact = date_time_nanoseconds(text)
    if exact is not None:
        return [exact]
    with suppress(ValueError):
        return [parse_moment("--around", text).at(recording.start_ns, recording.end_ns)]
    if not text.startswith("@") and not _QUERY.search(text):
        return ConditionReader().times(recording, parse_condition(text))
    settings = Settings(types=options.types)
    found = solutions(path, query_text(text), settings)
    for name in found["head"]["vars"]:
        values = [row[name]["value"] for row in found["results"]["bindings"] if name in row]
        times = [date_time_nanoseconds(value) for value in values]
        if times and None not in times:
            return [time for time in times if time is not None]
    if found["results"]["bindings"]:
        raise ValueError("--around: no column of the query's results has only values of xsd:dateTime")
    return ()
