"""Parts of recordings: how a recording is cut, and the task of making what a part becomes, which a worker runs.

A part is a range of message numbers. The cut depends on the recording alone, not on the number of workers.
"""

from __future__ import annotations

import pickle
import shutil
import tempfile
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import click
from msgspec import Struct

import rosld
from rosld.adapters.base import FOR_EVER, Recording
from rosld.adapters.model import RosError
from rosld.server.cli.failure import Failure, reason
from rosld.server.cli.recording_inputs import Selection, Source, TypeTexts, open_recording

BLOCK_BYTES, BLOCK_MESSAGES = 1 << 20, 1000
"""Size of a block: a part is cut at the boundaries of blocks only, so that how it was cut leaves no trace."""


class Part(NamedTuple):
    """Messages `start` to `end` (exclusive) of a source, by its number."""

    source: int
    start: int
    end: int

    @property
    def folder(self) -> str:
        """The name of the folder with the part's results."""
        return f"{self.source}-{self.start}-{self.end}"


class Cut(NamedTuple):
    """How a recording is cut: its messages and those of a block, its identity, and whether a topic is selected."""

    messages: int
    block: int
    identity: str
    is_selected: bool

    def parts(self, source: int, size: int, job: Job) -> list[Part]:
        """Return the parts of a recording of this size in bytes."""
        blocks = -(-self.messages // self.block)
        step = max(1, min(blocks * job.part_bytes // max(size, 1), job.part_messages // self.block)) * self.block
        ends = [*range(step, self.messages, step), self.messages]
        return [Part(source, start, end) for start, end in zip([0, *ends], ends, strict=False)]

    def halves(self, part: Part) -> list[Part]:
        """Return the two halves of a part, or none if it is a single block."""
        blocks = -(-(part.end - part.start) // self.block)
        middle = part.start + blocks // 2 * self.block
        return [] if blocks < 2 else [part._replace(end=middle), part._replace(start=middle)]


class Outcome(Struct, frozen=True):
    """Result of a part: its selected messages, by reason those that could not be read, and its files with a digest.

    The content of files is included only if the worker does not share a disk with the command.
    """

    messages: int
    unread: dict[str, int]
    digest: int = 0
    files: tuple[tuple[str, bytes], ...] | None = None


class Job(Struct, frozen=True):
    """What is made of messages: a picklable value."""

    selection: Selection

    @property
    def part_bytes(self) -> int:
        """The maximum size of a part in the recording."""
        return 16 << 20

    @property
    def part_messages(self) -> int:
        """The maximum number of messages in a part."""
        return FOR_EVER

    @property
    def identity(self) -> str:
        """A text that differs for jobs with different results."""
        return repr(self)

    def of_halves(self) -> Job:
        """Return the job whose results for the halves of a part can be joined."""
        return self

    def make(self, recording: Recording, part: Part, block: int, folder: Path, *, simulated_time: bool) -> Outcome:
        """Write the files of a part into a folder."""
        raise NotImplementedError


class Task(Struct, frozen=True):
    """A task for a worker: to make the files of a part, or without a cut to return that of the recording.

    A recording of at most `single` messages is made with its cut, so that it is opened once. `folder` is None if the
    worker does not share a disk with the command.
    """

    source: Source
    types: TypeTexts
    job: Job
    part: Part
    cut: Cut | None = None
    folder: str | None = None
    single: int = -1


class Answer(Struct, frozen=True):
    """The answer to a task: its result, or an error. `is_death`: a smaller part may succeed; `is_final`: none will."""

    result: Any = None
    error: str | None = None
    is_death: bool = False
    is_final: bool = False


DEATH = Answer(error="its worker was killed (is there enough memory?)", is_death=True)


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


def _result(task: Task) -> tuple[Cut, Outcome | None]:
    recording, simulated_time = open_recording(task.source, task.types)
    cut, part = task.cut, task.part
    if cut is None:
        block = max(1, min(BLOCK_MESSAGES, recording.count * BLOCK_BYTES // max(task.source.size, 1)))
        is_selected = task.job.selection.topics_of(recording) != frozenset()
        cut = Cut(recording.count, block, recording.identity, is_selected)
        if cut.messages > task.single or not is_selected:
            return cut, None
        part = part._replace(end=cut.messages)
    elif recording.identity != cut.identity:
        raise Failure("it has changed since the start")
    with tempfile.TemporaryDirectory(prefix=".", dir=task.folder) as folder:
        draft = Path(folder, "files")
        draft.mkdir()
        outcome = task.job.make(recording, part, cut.block, draft, simulated_time=simulated_time)
        digest, files = digest_of(draft), None
        if task.folder is None:
            files = tuple((each.name, each.read_bytes()) for each in sorted(draft.iterdir()))
        else:
            target = Path(task.folder, part.folder)
            shutil.rmtree(target, ignore_errors=True)
            draft.rename(target)
        return cut, Outcome(outcome.messages, outcome.unread, digest, files)


def digest_of(folder: Path) -> int:
    """Return a checksum of the files in a folder."""
    digest = 0
    for path in sorted(folder.iterdir()):
        digest = zlib.crc32(path.name.encode(), digest)
        with path.open("rb") as file:
            while piece := file.read(1 << 20):
                digest = zlib.crc32(piece, digest)
    return digest
