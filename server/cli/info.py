"""`rosld info`: what recordings contain."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias
from urllib.parse import urlencode

import click

from rosld.adapters.base import Adapter, AdapterOptions, Recording
from rosld.ontology.literals import date_time
from rosld.server.cli.failure import ExitCode, Failure, only_errors, user_errors
from rosld.server.cli.list_types import open_source
from rosld.server.cli.tables import duration_text, json_text, print_table, size_text
from rosld.server.history.cut import selected

Facts: TypeAlias = dict[str, Any]


@contextmanager
def open_recording(
    path: str, options: AdapterOptions, period: Mapping[str, str | None] | None = None
) -> Iterator[tuple[Recording, Adapter]]:
    """Open a recording, or its part between the times `from` and `to` of a period. Raises Failure."""
    query = urlencode({name: value for name, value in (period or {}).items() if value is not None})
    source = f"recording:{path}{'&' if '?' in path else '?'}{query}" if query else f"recording:{path}"
    with user_errors(ExitCode.USAGE), only_errors("rosld.recording"), open_source(source, options) as adapter:
        if adapter.catalogue is not None:
            raise Failure(f"{path} is a folder of recordings: name one of them, which rosld ls lists", ExitCode.USAGE)
        (recording,) = adapter.recordings.values()
        yield recording, adapter


def info(
    files: Sequence[str],
    topics: Sequence[str],
    period: Mapping[str, str | None],
    options: AdapterOptions,
    *,
    as_json: bool,
) -> None:
    """Print what recordings contain, in a period and of some topics. Raises Failure for the last unreadable one."""
    found: list[Facts] = []
    failures: list[Failure] = []
    for file in files:
        try:
            with open_recording(file, options, period) as (recording, _):
                found.append(facts_of(file, recording, topics))
        except Failure as failure:
            failures.append(failure)
    if as_json and found:
        click.echo(json_text(found if len(files) > 1 else found[0]))
    for number, facts in enumerate([] if as_json else found):
        click.echo("\n" if number else "", nl=False)
        _print(facts)
    for each in failures[:-1]:
        each.show()
    if failures:
        raise failures[-1]


def facts_of(path: str, recording: Recording, topics: Sequence[str] = ()) -> Facts:
    """Return the facts about a recording and these of its topics, for JSON."""
    selects = selected(topics)
    duration = (recording.end_ns - recording.start_ns) / 1e9
    described = [
        {
            "name": each.name,
            "type": each.type.name,
            "messages": each.count,
            "rate": round(each.count / duration, 2) if duration else None,
            **({"problem": each.unreadable} if each.unreadable else {}),
        }
        for each in sorted(recording.topics.values(), key=lambda topic: topic.name)
        if selects(each.name)
    ]
    return {
        "path": path,
        "name": recording.name,
        "format": recording.format,
        "size": size_of(recording.path),
        "start": date_time(0, recording.start_ns) if recording.count else None,
        "end": date_time(0, recording.end_ns) if recording.count else None,
        "duration": duration,
        "messages": sum(each["messages"] for each in described) if topics else recording.count,
        "topics": described,
        "notes": list(getattr(recording, "notes", ())),
    }


def size_of(path: Path) -> int:
    """Return the bytes of a file, or of all files in a folder."""
    files = [path] if path.is_file() else path.rglob("*")
    return sum(each.stat().st_size for each in files if each.is_file())


def _print(facts: Facts) -> None:
    click.secho(facts["path"], bold=True)
    lines = (
        ("format", facts["format"]),
        ("size", size_text(facts["size"])),
        ("duration", duration_text(facts["duration"])),
        ("start", facts["start"]),
        ("end", facts["end"]),
        ("messages", f"{facts['messages']:,}"),
    )
    for name, value in lines:
        click.echo(f"{name + ':':10}{value or '-'}")
    for note in facts["notes"]:
        click.secho(f"note:     {note}", fg="yellow")
    rows = [
        (each["name"], each["type"], f"{each['messages']:,}", f"{each['rate'] or 0:g} Hz", each.get("problem", ""))
        for each in facts["topics"]
    ]
    click.echo()
    print_table(("topic", "type", "messages", "rate", "problem"), rows, frozenset({"messages", "rate"}))
