"""`rosld ls`: the recordings in folders, and which of them fulfil a condition on numbers."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import click

from rosld.adapters.base import AdapterOptions
from rosld.server.cli.failure import ExitCode, Failure, user_errors
from rosld.server.cli.info import Facts, facts_of, open_recording, size_of
from rosld.server.cli.tables import duration_text, json_text, print_table, size_text
from rosld.server.history.cut import selected
from rosld.server.resources.number_conditions import ConditionReader, parse_condition

_SUFFIXES = (".bag", ".mcap", ".db3", ".bag.zst", ".mcap.zst", ".db3.zst")
_METADATA = "metadata.yaml"
"""File that makes a folder a recording of rosbag2."""


def list_recordings(
    folders: Sequence[Path], where: str | None, topics: Sequence[str], options: AdapterOptions, *, as_json: bool
) -> None:
    """Print the recordings below folders that have all of these topics and fulfil a condition. Raises Failure.

    Unreadable recordings are listed with their problem; with a condition, they make the result incomplete.
    """
    with user_errors(ExitCode.USAGE):
        condition = () if where is None else parse_condition(where)
    found: list[Facts] = []
    failures: list[Failure] = []
    reader, wanted = ConditionReader(), [selected([glob]) for glob in topics]
    for path in (path for folder in folders for path in recordings_below(folder)):
        try:
            with open_recording(str(path), options) as (recording, _):
                has_topics = all(any(map(selects, recording.topics)) for selects in wanted)
                if has_topics and reader.holds(recording, condition):
                    found.append(facts_of(str(path), recording))
        except Failure as failure:
            failures.append(failure)
            if not condition and not topics:
                found.append({"path": str(path), "size": size_of(path), "problem": failure.message})
    if as_json:
        click.echo(json_text(found))
    else:
        _print(found)
    if condition and not reader.has_numbers and reader.problem:
        raise Failure(f"--where {where}: {reader.problem}", ExitCode.USAGE)
    if failures and (condition or topics):
        for each in failures:
            each.show()
        raise Failure(f"{len(failures)} recordings cannot be read", ExitCode.INCOMPLETE)


def recordings_below(folder: Path) -> Iterator[Path]:
    """Yield the files and rosbag2 folders that look like recordings, in the order of their names."""
    if folder.is_file() or (folder / _METADATA).is_file():
        yield folder
        return
    for place, folders, files in os.walk(folder):
        bags = [each for each in folders if (Path(place) / each / _METADATA).is_file()]
        folders[:] = sorted(each for each in folders if each not in bags and not each.startswith("."))
        named = (each for each in files if each.endswith(_SUFFIXES) and not each.startswith("."))
        yield from (Path(place) / each for each in sorted([*bags, *named]))


def _print(found: Sequence[Facts]) -> None:
    rows = [
        (
            facts["path"],
            (facts.get("start") or "")[:19].replace("T", " "),
            duration_text(facts["duration"]) if "duration" in facts else "",
            f"{facts['messages']:,}" if "messages" in facts else "",
            size_text(facts["size"]),
            facts.get("problem") or "; ".join(facts.get("notes", ())),
        )
        for facts in found
    ]
    head = ("recording", "start", "duration", "messages", "size", "problem")
    print_table(head, rows, frozenset({"duration", "messages", "size"}))
