"""`rosld export`: recordings as a folder of tables, partitioned by topic and run, made in parts and in parallel."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote, unquote

from msgspec.structs import replace

from rosld.adapters.base import RecordedMessage, Recording
from rosld.server.cli.conversion import Manifest, Output, Run, convert
from rosld.server.cli.failure import output_errors, user_errors
from rosld.server.cli.parts import Job, Outcome, Part
from rosld.server.cli.recording_inputs import Source
from rosld.server.history.tables import NoTable, TopicTable, pieces, require_pyarrow

if TYPE_CHECKING:
    import pyarrow as pa

SUFFIXES: Mapping[str, str] = {"parquet": "parquet", "csv": "csv", "arrow": "arrows"}
_PAGE = 4096
"""Number of messages read at once, and those of a topic that are converted at once."""
_GROUP_ROWS = 65_536
"""Number of rows in a row group."""
_UNREADABLE = b"unreadable"


class ExportJob(Job, frozen=True, kw_only=True):
    """To write a file of each topic. `is_half`: as Arrow with all metadata, to be joined with other files."""

    format: str
    is_half: bool = False

    @property
    def part_bytes(self) -> int:
        return 32 << 20

    def of_halves(self) -> Job:
        return replace(self, is_half=True)

    def make(self, recording: Recording, part: Part, block: int, folder: Path, *, simulated_time: bool) -> Outcome:
        unread: Counter[str] = Counter()
        selected = 0
        for topic, tables in self._tables(recording, part, unread).items():
            table, parts = tables
            selected += sum(map(len, parts)) + table.unreadable
            schema = table.schema.with_metadata({**table.schema.metadata, _UNREADABLE: str(table.unreadable).encode()})
            unread[f"{topic}: they do not fit their type"] += table.unreadable
            if parts := [each for each in parts if len(each)]:
                write_table(folder / quote(topic, safe=""), schema, parts, "arrow" if self.is_half else self.format)
        return Outcome(selected, dict(+unread))

    def _tables(
        self, recording: Recording, part: Part, unread: Counter[str]
    ) -> dict[str, tuple[TopicTable, list[pa.Table]]]:
        """Return the table of each topic in parts; count the messages of topics without one."""
        held: dict[str, list[RecordedMessage]] = {}
        found: dict[str, tuple[TopicTable, list[pa.Table]]] = {}
        start: int | None = part.start
        while start is not None:
            page = recording.select(self.selection.criteria(recording, start, part.end), _PAGE)
            start = page.next
            for each in page.messages:
                held.setdefault(each.topic, []).append(each)
            for topic in [topic for topic, messages in held.items() if start is None or len(messages) >= _PAGE]:
                messages = held.pop(topic)
                try:
                    if topic not in found:
                        found[topic] = TopicTable(recording, topic), []
                except NoTable as error:
                    unread[f"{topic}: {error}"] += len(messages)
                else:
                    table, parts = found[topic]
                    parts.append(table.table_of(messages))
        return found


def write_table(path: Path, schema: pa.Schema, parts: Sequence[pa.Table], format: str) -> None:
    """Write a table, whose bytes do not depend on the parts it consists of."""
    import pyarrow as pa

    plain = pa.concat_tables([each.replace_schema_metadata(schema.metadata) for each in parts]).combine_chunks()
    groups = [plain.slice(at, _GROUP_ROWS) for at in range(0, len(plain), _GROUP_ROWS)]
    with path.open("wb") as file:
        file.writelines(pieces(format, (schema, groups)))


def export(
    inputs: Sequence[str], types: Sequence[Path], job: ExportJob, output: Path, workers: int | None, dask: str | None
) -> None:
    """Write recordings into a folder. Raises Failure."""
    with user_errors():
        require_pyarrow()
    path = output.resolve()
    with output_errors():
        path.parent.mkdir(parents=True, exist_ok=True)
    convert(inputs, types, job, TableFolder(path, job.format), path.with_name(f".{path.name}.parts"), workers, dask)


class TableFolder(Output):
    """A folder of tables, `topic=TOPIC/run=RUN/part-N.SUFFIX` as Hive has it; other files in it remain."""

    is_divisible = True

    def __init__(self, path: Path, format: str) -> None:
        self.name = str(path)
        self._path = path
        self._format = format

    def begin(self, manifest: Manifest, sources: Sequence[Source]) -> None:
        self._folder = manifest.folder
        self._sources = sources

    def finish(self, run: Run) -> None:
        """Place the files of all runs of which no part failed, and remove their former ones."""
        incomplete = {part.source for part in run.failed}
        places: dict[Path, set[str]] = {}
        for number, source in enumerate(self._sources):
            planned = [part for part in run.planned if part.source == number and number not in incomplete]
            for place, whole in enumerate(planned):
                for topic, path in self._files(run, whole):
                    folder = self._path / f"topic={_escaped(topic.strip('/'))}" / f"run={_escaped(source.name)}"
                    name = f"part-{place}.{SUFFIXES[self._format]}"
                    folder.mkdir(parents=True, exist_ok=True)
                    places.setdefault(folder, set()).add(name)
                    _place(path, folder / name)
        for folder, names in places.items():
            for path in folder.glob("part-*"):
                if path.name not in names:
                    path.unlink()

    def _files(self, run: Run, whole: Part) -> Iterator[tuple[str, Path]]:
        """Yield topics and files of a part as it was planned."""
        parts = [each for each in run.parts if each.source == whole.source and whole.start <= each.start < whole.end]
        if parts in ([whole], []):
            folder = self._folder / whole.folder
            yield from ((unquote(path.name), path) for path in sorted(folder.iterdir()))
            return
        joined = self._folder / f"joined-{whole.folder}"
        joined.mkdir(exist_ok=True)
        for name in sorted({path.name for part in parts for path in (self._folder / part.folder).iterdir()}):
            _join([self._folder / part.folder / name for part in parts], joined / name, self._format)
            yield unquote(name), joined / name


def _join(paths: Sequence[Path], target: Path, format: str) -> None:
    """Write the tables of several files of Arrow to one file."""
    import pyarrow as pa

    tables: list[pa.Table] = []
    for path in paths:
        if path.exists():
            with path.open("rb") as file:
                tables.append(pa.ipc.open_stream(file).read_all())
    unreadable = sum(int(each.schema.metadata[_UNREADABLE]) for each in tables)
    schema = tables[0].schema.with_metadata({**tables[0].schema.metadata, _UNREADABLE: str(unreadable).encode()})
    write_table(target, schema, tables, format)


def _place(path: Path, target: Path) -> None:
    """Put a file where it belongs, without moving it: it may be needed again after an interruption."""
    draft = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        try:
            os.link(path, draft)
        except OSError:
            shutil.copyfile(path, draft)
        draft.replace(target)
    finally:
        draft.unlink(missing_ok=True)


def _escaped(name: str) -> str:
    return quote(name, safe=" ")
