"""Work on recordings in parts, on one core, on worker processes or on a Dask cluster, with the same result.

A part is a range of message numbers. The cut depends on the recordings alone, results are joined in order, and a
manifest in a folder beside the output lists the finished parts, so that a run that was killed continues where it was.
A worker that dies (usually for lack of memory) has its part cut in two; no part ends the others.
"""

from __future__ import annotations

import fcntl
import gc
import io
import json
import multiprocessing
import os
import pickle
import shutil
import signal
import sys
import tempfile
import threading
import zlib
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor
from concurrent.futures import wait as wait_for
from contextlib import ExitStack, contextmanager
from importlib import import_module
from multiprocessing import connection, util
from pathlib import Path
from typing import Any, NamedTuple

import click
from msgspec import Struct
from msgspec.structs import replace

import rosld
from rosld.adapters.base import FOR_EVER, Recording
from rosld.adapters.model import RosError
from rosld.server.cli.failure import ExitCode, Failure, reason
from rosld.server.cli.recording_inputs import Selection, Source, TypeTexts, close_recordings, open_recording

PART_BYTES = 16 << 20
"""Bytes of a recording in a part."""
BLOCK_BYTES, BLOCK_MESSAGES = 1 << 20, 1000
"""Size of a block: a part is cut at the boundaries of blocks only, so that how it was cut leaves no trace."""
SMALL = 4 << 20
"""Bytes of recordings for which starting worker processes (about a second) does not pay."""
_LINE = "manifest.jsonl"
_DEATHS = 4
"""Deaths of workers after which a part that cannot be cut any further fails."""


class Part(NamedTuple):
    """Messages `start` to `end` (exclusive) of a source, by its number."""

    source: int
    start: int
    end: int

    @property
    def folder(self) -> str:
        """The name of the folder with the part's results."""
        return f"{self.source}-{self.start}-{self.end}"


_NONE = Part(-1, 0, 0)


class Cut(NamedTuple):
    """How a recording is cut: its messages and those of a block, its identity, and whether a topic is selected."""

    messages: int
    block: int
    identity: str
    is_selected: bool

    def parts(self, source: int, size: int, most: int) -> list[Part]:
        """Return the parts of a recording of this size in bytes, each of at most `most` messages."""
        blocks = -(-self.messages // self.block)
        step = max(1, min(-(-blocks * PART_BYTES // max(size, 1)), most // self.block)) * self.block
        ends = [*range(step, self.messages, step), self.messages]
        return [
            Part(source, start, end) for start, end in zip(range(0, max(self.messages, 1), step), ends, strict=True)
        ]

    def halves(self, part: Part) -> list[Part]:
        """Return the two halves of a part, or none if it is a single block."""
        blocks = -(-(part.end - part.start) // self.block)
        middle = part.start + blocks // 2 * self.block
        return [] if blocks < 2 else [part._replace(end=middle), part._replace(start=middle)]


class Outcome(Struct, frozen=True):
    """Result of a part: messages read, and by reason those that were not; digest of its files, and their content.

    Content is included only if the worker does not share a disk with the command.
    """

    messages: int
    unread: dict[str, int]
    digest: int = 0
    files: tuple[tuple[str, bytes], ...] | None = None


class Job(Struct, frozen=True):
    """What is made of messages: a picklable value."""

    selection: Selection

    @property
    def part_messages(self) -> int:
        """The maximum number of messages in a part."""
        return FOR_EVER

    @property
    def identity(self) -> str:
        """A text that differs for jobs with different results."""
        return repr(self)

    def make(self, recording: Recording, part: Part, block: int, folder: Path, *, simulated_time: bool) -> Outcome:
        """Write the files of a part into a folder."""
        raise NotImplementedError


class Task(Struct, frozen=True):
    """A task for a worker: to make the files of a part, or without a job to return the cut of a recording.

    `folder` is None if the worker does not share a disk with the command.
    """

    source: Source
    types: TypeTexts
    job: Job | None
    selection: Selection
    part: Part
    cut: Cut | None = None
    folder: str | None = None


class Answer(Struct, frozen=True):
    """The answer to a task: its result, or an error. `is_death`: a smaller part may succeed; `is_final`: none will."""

    result: Any = None
    error: str | None = None
    is_death: bool = False
    is_final: bool = False


_DEATH = Answer(error="its worker was killed (is there enough memory?)", is_death=True)


def run_task(version: str, task: bytes) -> Answer:
    """Run a pickled task in a worker. Errors are part of the answer: not every exception can be pickled."""
    if version != rosld.__version__:
        words = f"this worker has rosld {rosld.__version__}, and the task comes from rosld {version}"
        return Answer(error=f"{words}; install the same version on both", is_final=True)
    try:
        return Answer(_result(pickle.loads(task)))
    except MemoryError:
        return Answer(error="its worker ran out of memory", is_death=True)
    except click.ClickException as error:
        return Answer(error=error.message)
    except OSError as error:
        return Answer(error=reason(error))
    except (RosError, ValueError) as error:
        return Answer(error=str(error))
    except Exception as error:
        return Answer(error=f"{type(error).__name__}: {error}")


def _result(task: Task) -> Outcome | Cut:
    recording, simulated_time = open_recording(task.source, task.types)
    if task.job is None or task.cut is None:
        block = max(1, min(BLOCK_MESSAGES, recording.count * BLOCK_BYTES // max(task.source.size, 1)))
        is_selected = task.selection.topics_of(recording) != frozenset()
        return Cut(recording.count, block, recording.identity, is_selected)
    if recording.identity != task.cut.identity:
        raise Failure("it has changed since the start")
    with tempfile.TemporaryDirectory(prefix=".", dir=task.folder) as folder:
        draft = Path(folder, "files")
        draft.mkdir()
        outcome = task.job.make(recording, task.part, task.cut.block, draft, simulated_time=simulated_time)
        if task.folder is None:
            files = tuple((each.name, each.read_bytes()) for each in sorted(draft.iterdir()))
            return Outcome(outcome.messages, outcome.unread, digest_of(draft), files)
        target = Path(task.folder, task.part.folder)
        shutil.rmtree(target, ignore_errors=True)
        digest = digest_of(draft)
        draft.rename(target)
        return Outcome(outcome.messages, outcome.unread, digest)


def digest_of(folder: Path) -> int:
    """Return a checksum of the files in a folder."""
    digest = 0
    for path in sorted(folder.iterdir()):
        digest = zlib.crc32(path.name.encode(), digest)
        with path.open("rb") as file:
            while piece := file.read(1 << 20):
                digest = zlib.crc32(piece, digest)
    return digest


class InProcess(Executor):
    """Executor that runs each task at once in this thread."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


def _begin_worker() -> None:
    """Prepare a worker process, which ends when its parent is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes of the terminal
    gc.freeze()
    util.Finalize(None, close_recordings, exitpriority=10)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Pool:
    """Workers: this process, `workers` processes, or those of a Dask scheduler. Dead processes are replaced."""

    def __init__(self, workers: int, dask: str | None = None) -> None:
        """Connect to the Dask scheduler, if any. Raises Failure."""
        self.shares_disk = dask is None
        self._stack = ExitStack()
        self._limit = workers + 2 if workers > 1 else 1
        self._make: Callable[[], Executor] = InProcess
        if dask is not None:
            client = self._stack.enter_context(_dask_client(dask))
            self._limit = 2 * max(1, sum(client.nthreads().values()))
            self._make = lambda: client.get_executor(pure=False)
        elif workers > 1:
            # A fork of this process would copy its threads' locks; a fork of the server has the modules loaded.
            context = multiprocessing.get_context("forkserver")
            context.set_forkserver_preload(["rosld.server.cli.lift", "rosld.server.cli.parallel"])
            self._make = lambda: ProcessPoolExecutor(workers, context, _begin_worker)
        self._executor = self._make()

    def answers(self, waiting: deque[Task]) -> Iterator[tuple[Task, Answer]]:
        """Run tasks, and yield each with its answer, until `waiting` is empty; more may be added meanwhile.

        All tasks of a pool fail when one worker dies. They run again, after a second time one by one, to find the task
        that kills workers. Raises Failure if workers cannot run tasks.
        """
        running: dict[Future[Answer], Task] = {}
        suspects: deque[Task] = deque()
        deaths: Counter[Part] = Counter()
        while waiting or suspects or running:
            queue, limit = (suspects, 1) if suspects else (waiting, self._limit)
            while queue and len(running) < limit:
                try:
                    running[self._submit(queue[0])] = queue[0]
                except BrokenExecutor:
                    if running:
                        break
                    self._renew()
                else:
                    queue.popleft()
            wait_for(running, return_when=FIRST_COMPLETED)
            if any(each.done() and _is_broken(each) for each in running):
                wait_for(running)
            dead: list[Task] = []
            for future in [each for each in running if each.done()]:
                task = running.pop(future)
                if _is_broken(future):
                    dead.append(task)
                else:
                    yield task, _answer(future)
            if not dead:
                continue
            self._renew()
            deaths.update(task.part for task in dead)
            for task in reversed(dead):
                if len(dead) == 1:
                    yield task, _DEATH
                else:
                    (waiting if deaths[task.part] < 2 else suspects).appendleft(task)

    def _submit(self, task: Task) -> Future[Answer]:
        return self._executor.submit(run_task, rosld.__version__, pickle.dumps(task))

    def _renew(self) -> None:
        self._executor.shutdown(wait=True)  # a worker of a broken pool may still be writing
        self._executor = self._make()

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, kind: type[BaseException] | None, *args: object) -> None:
        """End the workers, in the midst of their tasks after an exception."""
        if kind is not None and isinstance(self._executor, ProcessPoolExecutor):
            for process in list((self._executor._processes or {}).values()):
                process.kill()
        if isinstance(self._executor, ProcessPoolExecutor | InProcess):
            self._executor.shutdown(cancel_futures=True)
        else:
            self._executor.shutdown(wait=kind is None)
        self._stack.close()
        close_recordings()


def _dask_client(address: str) -> Any:
    try:
        distributed = import_module("distributed")
    except ImportError as error:
        raise Failure("--dask needs Dask: pip install 'rosld[dask]'") from error
    try:
        return distributed.Client(address, timeout=10, set_as_default=False)
    except (OSError, ValueError) as error:
        raise Failure(f"--dask {address}: {error}", ExitCode.UNREACHABLE) from error


def _is_broken(future: Future[Answer]) -> bool:
    return future.cancelled() or isinstance(future.exception(), BrokenExecutor | CancelledError)


def _answer(future: Future[Answer]) -> Answer:
    error = future.exception()
    if error is None:
        return future.result()
    if type(error).__name__ == "KilledWorker":  # Dask has given the task to several workers, which all died
        return _DEATH
    raise Failure(f"the workers cannot run tasks of rosld: {type(error).__name__}: {error}") from error


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

    def remove(self) -> None:
        """Remove the folder."""
        self.close()
        shutil.rmtree(self.folder, ignore_errors=True)

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
    """Result of a run: all parts in order, the outcomes of the finished ones, and errors of parts and of sources."""

    parts: list[Part]
    cuts: Mapping[int, Cut]
    done: Mapping[Part, Outcome]
    failed: Mapping[Part, str]
    unreadable: Mapping[int, str]

    def report(self, sources: Sequence[Source]) -> bool:
        """Print what could not be read to stderr; return whether all parts are finished."""
        unread: Counter[str] = Counter()
        for outcome in self.done.values():
            unread.update(outcome.unread)
        lines = [f"{count} messages are listed but could not be read: {words}" for words, count in unread.most_common()]
        lines += [f"{sources[number].location} is left out: {error}" for number, error in self.unreadable.items()]
        for part, error in self.failed.items():
            lines.append(f"{sources[part.source].location}, messages {part.start} to {part.end - 1}: {error}")
        for line in lines:
            click.echo(f"rosld: {' '.join(line.split())}", err=True)
        return not self.failed


def run_parts(
    job: Job, sources: Sequence[Source], types: TypeTexts, pool: Pool, manifest: Manifest,
    join: Callable[[Part], None] | None = None,
) -> Run:  # fmt: skip
    """Compute all parts that are not finished, and call `join` for each as soon as all before it are finished.

    Raises Failure if no source can be read, or none has a selected topic.
    """
    unreadable = _cut_all(job, sources, types, pool, manifest)
    cuts, done = manifest.cuts, manifest.done
    if not cuts:
        first = next(iter(unreadable.values()))
        words = first if len(sources) == 1 else f"none of the recordings can be read; the first: {first}"
        raise Failure(words, ExitCode.INPUT)
    if not any(cut.is_selected for cut in cuts.values()):
        raise Failure(f"no recording has a topic that matches {', '.join(job.selection.topics)}", ExitCode.INPUT)
    planned = [part for n in sorted(cuts) for part in cuts[n].parts(n, sources[n].size, job.part_messages)]
    cut_further = [part for part in done if part not in set(planned)] if done else []
    parts = [each for part in planned for each in _settled(part, cuts[part.source], done, cut_further)]
    folder = str(manifest.folder) if pool.shares_disk else None
    waiting = deque(
        Task(sources[part.source], types, job, job.selection, part, cuts[part.source], folder)
        for part in parts
        if part not in done
    )
    failed: dict[Part, str] = {}
    deaths: Counter[Part] = Counter()
    with _progress(sources, cuts) as advance:
        for part in parts:
            if part in done:
                advance(part)
        at = _join(parts, 0, manifest, join)
        for task, answer in pool.answers(waiting):
            part = task.part
            if answer.is_final:
                raise Failure(str(answer.error))
            if answer.is_death:
                deaths[part] += 1
                again = cuts[part.source].halves(part) or ([part] if deaths[part] < _DEATHS else [])
                if again:
                    place = parts.index(part)
                    parts[place : place + 1] = again
                    waiting.extendleft(replace(task, part=each) for each in reversed(again))
                    continue
            if answer.error is not None:
                failed[part] = answer.error
                continue
            _keep(part, answer.result, manifest)
            advance(part)
            at = _join(parts, at, manifest, join)
    return Run(parts, cuts, done, failed, unreadable)


def _cut_all(
    job: Job, sources: Sequence[Source], types: TypeTexts, pool: Pool, manifest: Manifest
) -> Mapping[int, str]:
    """Add the cuts of all sources to the manifest; return the errors of those that cannot be read. Raises Failure."""
    waiting = deque(
        Task(source, types, None, job.selection, Part(number, 0, 0))
        for number, source in enumerate(sources)
        if number not in manifest.cuts
    )
    unreadable: dict[int, str] = {}
    deaths: Counter[int] = Counter()
    for task, answer in pool.answers(waiting):
        number = task.part.source
        deaths[number] += answer.is_death
        if answer.is_final:
            raise Failure(str(answer.error))
        if answer.is_death and deaths[number] < _DEATHS:
            waiting.append(task)
        elif answer.error is not None:
            unreadable[number] = answer.error
        else:
            manifest.cuts[number] = answer.result
            manifest.note(source=number, cut=answer.result)
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


def _join(parts: Sequence[Part], at: int, manifest: Manifest, join: Callable[[Part], None] | None) -> int:
    """Join finished parts from place `at` on; return the place of the first unfinished one."""
    while join is not None and at < len(parts) and parts[at] in manifest.done:
        if not manifest.is_joined(parts[at]):
            join(parts[at])
        at += 1
    return at


@contextmanager
def _progress(sources: Sequence[Source], cuts: Mapping[int, Cut]) -> Iterator[Callable[[Part], None]]:
    """Yield a function that advances a bar on stderr (if that is a terminal): messages, bytes and the time left."""
    octets = 0.0
    label = sources[0].name if len(sources) == 1 else f"{len(sources)} recordings"

    def advance(part: Part) -> None:
        nonlocal octets
        octets += sources[part.source].size * (part.end - part.start) / max(cuts[part.source].messages, 1)
        bar.update(part.end - part.start)

    with click.progressbar(
        range(sum(cut.messages for cut in cuts.values())),
        label=label,
        file=sys.stderr if sys.stderr.isatty() else io.StringIO(),
        show_pos=True,
        item_show_func=lambda _: f"{octets / 1e6:.0f} MB",
    ) as bar:
        yield advance
