"""`rosld ls`: the recordings in folders, and which of them fulfil a condition on numbers."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack, closing
from pathlib import Path

import click
from msgspec.structs import replace

from rosld.adapters.base import AdapterOptions
from rosld.adapters.catalogue import NAME as CATALOGUE
from rosld.adapters.catalogue import Row
from rosld.server.cli.failure import ExitCode, Failure, only_errors, user_errors
from rosld.server.cli.info import Facts, facts_of
from rosld.server.cli.list_types import open_source
from rosld.server.cli.tables import duration_text, json_text, print_table, size_text
from rosld.server.history.cut import selected
from rosld.server.history.statistics import Statistics
from rosld.server.resources.number_conditions import ConditionReader, parse_condition


def list_recordings(
    folders: Sequence[Path], where: str | None, topics: Sequence[str], options: AdapterOptions, *, as_json: bool
) -> None:
    """Print the recordings at and below paths that have all of these topics and fulfil a condition. Raises Failure.

    Unreadable recordings are listed with their problem; with a condition, they make the result incomplete.
    """
    with user_errors(ExitCode.USAGE):
        condition = () if where is None else parse_condition(where)
    wanted, found = [selected([glob]) for glob in topics], list[Facts]()
    unreadable: list[Row] = []
    source = "\n".join(map(str, [*folders, folders[0]]))  # even one file, twice, is a collection
    with ExitStack() as stack:
        if len(folders) > 1 or not folders[0].is_dir():  # a catalogue in a folder is of that folder alone
            temporary = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            options = replace(options, catalogue=temporary / CATALOGUE)
        stack.enter_context(user_errors(ExitCode.USAGE))
        stack.enter_context(only_errors("rosld.recording"))
        adapter = stack.enter_context(open_source(f"recording:{source}", options))
        catalogue = adapter.catalogue
        assert catalogue is not None
        statistics = stack.enter_context(closing(Statistics(catalogue.path)))
        reader = ConditionReader(statistics if condition else None)
        for row in catalogue.rows(sort="start"):
            if row.is_missing or row.is_own:
                continue
            if not row.is_readable:
                unreadable.append(row)
                continue
            names = [topic.name for topic in catalogue.topics(row.id)]
            if all(any(map(selects, names)) for selects in wanted):
                recording = adapter.recordings[row.name]
                if reader.holds(recording, condition):
                    found.append({**facts_of(_shown(row.path), recording), "size": row.size})
    is_partial = bool(unreadable) and bool(condition or topics)
    if not is_partial:
        found += [{"path": _shown(row.path), "size": row.size, "problem": row.problem} for row in unreadable]
    if as_json:
        click.echo(json_text(found))
    else:
        _print(found)
    if condition and not reader.has_numbers and reader.problem:
        raise Failure(f"--where {where}: {reader.problem}", ExitCode.USAGE)
    if is_partial:
        for row in unreadable:
            click.echo(f"rosld: {_shown(row.path)}: {row.problem}", err=True)
        raise Failure(f"{len(unreadable)} recordings cannot be read", ExitCode.INCOMPLETE)


def _shown(path: Path) -> str:
    """Return a path relative to the current folder if it is below."""
    return os.path.relpath(path) if path.is_relative_to(Path.cwd()) else str(path)


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
