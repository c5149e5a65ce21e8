"""Conversion of recordings in parts: resumed, retried and joined, with the same result whoever makes the parts.

A manifest in a folder beside the output lists the finished parts, so that a run that was killed continues where it was.
A worker that dies (usually for lack of memory) has its part cut in two; no part ends the others.
"""

from __future__ import annotations

import fcntl
import gc
import io
import json
import shutil
import signal
import sys
import zlib
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple, NoReturn

import click
from msgspec.structs import replace

import rosld
from rosld.server.cli.failure import ExitCode, Failure, end_signals, output_errors, user_errors
from rosld.server.cli.parts import BLOCK_MESSAGES, Cut, Job, Outcome, Part, Task, digest_of
from rosld.server.cli.recording_inputs import Source, TypeTexts, find_sources, read_types
from rosld.server.cli.workers import Pool, usable_cores

SMALL = 4 << 20
"""Bytes of recordings for which starting worker processes (about a second) does not pay."""
_LINE = "manifest.jsonl"
_DEATHS = 4
"""Deaths of workers after which a part that cannot be cut any further fails."""
_NONE = Part(-1, 0, 0)


class Manifest:
    """Folder with finished parts and a list of them, one JSON object per line, locked while it is in use.

    `joined` is the last part of those that were already appended to the output, `size` the output's size then.
    """

    def __init__(self, folder: Path, sources: Sequence[Source], types: TypeTexts, job: Job) -> None:
        """Continue with the folder if it is about the same work, or empty it. Raises OSError, Failure."""
        self.folder = folder
        self.cuts: dict[int, Cut] = {}
        self.done: dict[Part, Outcome] = {}
        self.joined = _NONE
        self.size = 0
        head = {
            "rosld": rosld.__version__,
            "job": job.identity,
            "types": zlib.crc32(repr(types).encode()),
            "sources": [[each.location, each.name, each.size, each.stamp] for each in sources],
        }
        folder.mkdir(exist_ok=True)
        self._file = (folder / _LINE).open("a+b")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self._file.close()
            raise Failure(f"{folder}: another rosld is writing this output", ExitCode.OUTPUT) from error
        self._load(head)

    @property
    def joined_file(self) -> Path:
        """The file of joined parts."""
        return self.folder / "joined"

    def note(self, **line: object) -> None:
        """Append a line."""
        self._file.write(json.dumps(line).encode() + b"\n")
        self._file.flush()

    def is_joined(self, part: Part) -> bool:
        """Whether a part is in the file of joined parts."""
        return (part.source, part.end) <= (self.joined.source, self.joined.end)

    def close(self) -> None:
        """Release the lock; the folder remains."""
        self._file.close()

    def _load(self, head: Mapping[str, object]) -> None:
        self._file.seek(0)
        end = 0
        for number, text in enumerate(self._file):
            try:
                line = json.loads(text)
            except ValueError:
                break  # the run was killed while it wrote this line
            if number == 0 and line != head:
                break
            end += len(text)
            if "cut" in line:
                self.cuts[line["source"]] = Cut(*line["cut"])
            elif "joined" in line:
                self.joined, self.size = Part(*line["joined"]), line["size"]
            elif "part" in line:
                self.done[Part(*line["part"])] = Outcome(line["messages"], line["unread"], line["digest"])
        self._file.truncate(end)
        if self.size and (not self.joined_file.exists() or self.joined_file.stat().st_size < self.size):
            self.joined, self.size = _NONE, 0
        self.done = {
            part: each for part, each in self.done.items() if self.is_joined(part) or self._is_whole(part, each)
        }
        kept = {_LINE, self.joined_file.name, *(part.folder for part in self.done)}
        for path in self.folder.iterdir():
            if path.name not in kept:
                shutil.rmtree(path) if path.is_dir() else path.unlink()
        if not end:
            self.note(**head)

    def _is_whole(self, part: Part, outcome: Outcome) -> bool:
        folder = self.folder / part.folder
        return folder.is_dir() and digest_of(folder) == outcome.digest


class Run(NamedTuple):
    """Result of a run: its parts in order, and as they were planned; errors of parts and of sources by number."""

    parts: list[Part]
    planned: list[Part]
    cuts: Mapping[int, Cut]
    done: Mapping[Part, Outcome]
    failed: Mapping[Part, str]
    unreadable: Mapping[int, str]

    def report(self, sources: Sequence[Source]) -> None:
        """Print to stderr what could not be read."""
        unread: Counter[str] = Counter()
        for outcome in self.done.values():
            unread.update(outcome.unread)
        if not self.failed and not any(outcome.messages for outcome in self.done.values()):
            click.echo("rosld: no message was recorded on these topics at these times", err=True)
        lines = [f"{count} messages are listed but could not be read: {words}" for words, count in unread.most_common()]
        lines += [f"{sources[number].location} is left out: {error}" for number, error in self.unreadable.items()]
        for part, error in self.failed.items():
            lines.append(f"{sources[part.source].location}, messages {part.start} to {part.end - 1}: {error}")
        for line in lines:
            click.echo(f"rosld: {' '.join(line.split())}", err=True)


class Output:
    """Where finished parts go; this one keeps none. `is_divisible`: it is of use without the parts that failed."""

    name: str
    is_divisible = False

    def begin(self, manifest: Manifest, sources: Sequence[Source]) -> None:
        """Begin, or continue after the parts that were added before."""

    def add(self, part: Part) -> None:
        """Add a part. All parts before it were added."""

    def finish(self, run: Run) -> None:
        """Complete the output. All parts were added, but those that failed if it is divisible."""


def convert(
    inputs: Sequence[str], types: Sequence[Path], job: Job, output: Output, folder: Path, workers: int | None,
    dask: str | None,
) -> None:  # fmt: skip
    """Convert recordings, with the manifest in a folder that is removed at the end. Raises Failure.

    `workers` is None for one per core, or one for small recordings.
    """
    sources = find_sources(inputs)
    with _ended_by_signals():
        with user_errors():
            texts = read_types(types)
        with output_errors():
            manifest = Manifest(folder, sources, texts, job)
        try:
            if workers is None:
                workers = usable_cores() if sum(source.size for source in sources) > SMALL else 1
            output.begin(manifest, sources)
            with Pool(workers, dask) as pool:
                run = run_parts(job, sources, texts, pool, manifest, output)
            run.report(sources)
            if not run.failed or output.is_divisible:
                with output_errors():
                    output.finish(run)
            if run.failed:
                words = f"{output.name} is not complete; the same command computes the parts that are missing"
                raise Failure(words, ExitCode.INCOMPLETE)
        finally:
            manifest.close()
            if not manifest.done:
                shutil.rmtree(folder, ignore_errors=True)
        shutil.rmtree(folder, ignore_errors=True)
    if run.unreadable:
        raise Failure(f"{len(run.unreadable)} of {len(sources)} recordings are left out", ExitCode.INCOMPLETE)


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """Turn signals that end the command into exceptions, so that workers are ended, too."""
    before = {number: signal.signal(number, _exit) for number in end_signals() if number is not signal.SIGINT}
    gc.freeze()  # the garbage collector need not scan the loaded objects repeatedly
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _exit(number: int, frame: object) -> NoReturn:
    sys.exit(128 + number)


def run_parts(
    job: Job, sources: Sequence[Source], types: TypeTexts, pool: Pool, manifest: Manifest, output: Output
) -> Run:
    """Compute all parts that are not finished. Raises Failure if no source can be read, or no topic is selected."""
    cuts, done = manifest.cuts, manifest.done
    folder = str(manifest.folder) if pool.shares_disk else None
    with _progress(sources, cuts) as advance:
        for part in done:
            advance(part)

        def keep(part: Part, outcome: Outcome) -> None:
            _keep(part, outcome, manifest)
            advance(part)

        unreadable = _cut_all(job, sources, types, pool, manifest, folder, keep)
        if not cuts:
            first = next(iter(unreadable.values()))
            words = first if len(sources) == 1 else f"none of the recordings can be read; the first: {first}"
            raise Failure(words, ExitCode.INPUT)
        if not any(cut.is_selected for cut in cuts.values()):
            raise Failure(f"no recording has a topic that matches {', '.join(job.selection.topics)}", ExitCode.INPUT)
        planned = [part for number in sorted(cuts) for part in cuts[number].parts(number, sources[number].size, job)]
        whole = frozenset(planned)
        halves = [part for part in done if part not in whole]
        parts = [each for part in planned for each in _settled(part, cuts[part.source], done, halves)]

        def task(part: Part) -> Task:
            its = job if part in whole else job.of_halves()
            return Task(sources[part.source], types, its, part, cuts[part.source], folder)

        waiting = deque(task(part) for part in parts if part not in done)
        failed: dict[Part, str] = {}
        deaths: Counter[Part] = Counter()
        at = _add(parts, 0, manifest, output)
        for part, answer in ((task.part, answer) for task, answer in pool.answers(waiting)):
            if answer.is_death:
                deaths[part] += 1
                if again := cuts[part.source].halves(part) or ([part] if deaths[part] < _DEATHS else []):
                    place = parts.index(part)
                    parts[place : place + 1] = again
                    waiting.extendleft(task(each) for each in reversed(again))
                    continue
            if answer.error is not None:
                failed[part] = answer.error
                continue
            keep(part, answer.result[1])
            at = _add(parts, at, manifest, output)
    return Run(parts, planned, cuts, done, failed, unreadable)


def _cut_all(
    job: Job, sources: Sequence[Source], types: TypeTexts, pool: Pool, manifest: Manifest, folder: str | None,
    keep: Callable[[Part, Outcome], None],
) -> Mapping[int, str]:  # fmt: skip
    """Add the cuts of all sources to the manifest, and keep what was made of small ones.

    Return the errors of those that cannot be read. Raises Failure.
    """
    single = job.part_messages - BLOCK_MESSAGES
    waiting = deque(
        Task(source, types, job, Part(number, 0, 0), None, folder, single if source.size < SMALL else -1)
        for number, source in enumerate(sources)
        if number not in manifest.cuts
    )
    unreadable: dict[int, str] = {}
    deaths: Counter[int] = Counter()
    for task, answer in pool.answers(waiting):
        number = task.part.source
        deaths[number] += answer.is_death
        if answer.error is not None and (task.single >= 0 or (answer.is_death and deaths[number] < _DEATHS)):
            waiting.append(replace(task, single=-1))
        elif answer.error is not None:
            unreadable[number] = answer.error
        else:
            cut, outcome = answer.result
            manifest.cuts[number] = cut
            manifest.note(source=number, cut=cut)
            if outcome is not None:
                keep(Part(number, 0, cut.messages), outcome)
    return dict(sorted(unreadable.items()))


def _settled(part: Part, cut: Cut, done: Mapping[Part, Outcome], cut_further: Sequence[Part]) -> list[Part]:
    """Return the part, or its halves if one of them was finished before."""
    is_within = any(each.source == part.source and part.start <= each.start < part.end for each in cut_further)
    if part in done or not is_within or not (halves := cut.halves(part)):
        return [part]
    return [each for half in halves for each in _settled(half, cut, done, cut_further)]


def _keep(part: Part, outcome: Outcome, manifest: Manifest) -> None:
    """Store the files of a part, if the worker did not, and note it as finished."""
    if outcome.files is not None:
        folder = manifest.folder / part.folder
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        for name, content in outcome.files:
            (folder / name).write_bytes(content)
    manifest.done[part] = Outcome(outcome.messages, outcome.unread, outcome.digest)
    manifest.note(part=part, messages=outcome.messages, unread=outcome.unread, digest=outcome.digest)


def _add(parts: Sequence[Part], at: int, manifest: Manifest, output: Output) -> int:
    """Add finished parts from place `at` on to the output; return the place of the first unfinished one."""
    while at < len(parts) and parts[at] in manifest.done:
        if not manifest.is_joined(parts[at]):
            with output_errors():
                output.add(parts[at])
        at += 1
    return at


@contextmanager
def _progress(sources: Sequence[Source], cuts: Mapping[int, Cut]) -> Iterator[Callable[[Part], None]]:
    """Yield a function that advances a bar on stderr (if that is a terminal): messages, bytes and the time left."""
    messages = octets = 0
    total = sum(source.size for source in sources)
    label = sources[0].name if len(sources) == 1 else f"{len(sources)} recordings"

    def advance(part: Part) -> None:
        nonlocal messages, octets
        size, of_all = sources[part.source].size, max(cuts[part.source].messages, 1)
        step = size * part.end // of_all - size * part.start // of_all
        messages, octets = messages + part.end - part.start, octets + step
        bar.update(step)

    with click.progressbar(
        range(total),
        label=label,
        file=sys.stderr if sys.stderr.isatty() else io.StringIO(),
        item_show_func=lambda _: f"{octets / 1e6:.0f} of {total / 1e6:.0f} MB, {messages} messages",
    ) as bar:
        yield advance
