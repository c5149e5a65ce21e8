"""`rosld lift`: convert recordings to one file of RDF, or send them to a store, in parts and in parallel."""

from __future__ import annotations

import gc
import gzip
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, NoReturn

from msgspec import Struct

from rosld.adapters.base import Recording
from rosld.ontology.lift import LiftSettings
from rosld.ontology.syntax import Syntax
from rosld.ontology.urls import Space
from rosld.server.cli.failure import ExitCode, Failure, end_signals, output_errors, user_errors
from rosld.server.cli.parallel import SMALL, Job, Manifest, Outcome, Part, Pool, run_parts, usable_cores
from rosld.server.cli.rdf_writer import Lifting, writer
from rosld.server.cli.recording_inputs import Source, find_sources, read_types

SYNTAXES: Mapping[str, Syntax] = {
    ".nq": Syntax.N_QUADS,
    ".nt": Syntax.N_TRIPLES,
    ".ttl": Syntax.TURTLE,
    ".trig": Syntax.TRIG,
}
_COMPRESSION = 4
_BUFFER = 1 << 20
_PART_MESSAGES = 20_000
"""Maximum number of messages in a part: about 100 MB of N-Quads, where messages are small."""
_LIFTED = "lifted"


class Target(Struct, frozen=True):
    """The syntax and compression of a file."""

    syntax: Syntax
    compressed: bool


def target(name: str) -> Target:
    """Return the target with a file's name. Raises ValueError for an unknown suffix."""
    path = Path(name)
    compressed = path.suffix == ".gz"
    ending = (path.with_suffix("") if compressed else path).suffix
    if ending not in SYNTAXES:
        raise ValueError(f"{name}: the name must end in {', '.join(SYNTAXES)}, or one of these and .gz")
    return Target(SYNTAXES[ending], compressed)


class LiftJob(Job, frozen=True, kw_only=True):
    """To lift messages below a base URL."""

    base: str
    settings: LiftSettings
    target: Target

    @property
    def part_messages(self) -> int:
        return _PART_MESSAGES

    def make(self, recording: Recording, part: Part, block: int, folder: Path, *, simulated_time: bool) -> Outcome:
        space = Space(self.base, self.settings.types)
        lifting = Lifting(recording, space, self.settings, simulated_time=simulated_time)
        with (folder / _LIFTED).open("wb", _BUFFER) as file:
            for texts in self.blocks(lifting, part, block):
                if self.target.compressed:
                    file.write(gzip.compress(b"".join(texts), _COMPRESSION, mtime=0))
                else:
                    file.writelines(texts)
        return Outcome(part.end - part.start, dict(lifting.unread))

    def blocks(self, lifting: Lifting, part: Part, block: int) -> Iterator[Iterable[bytes]]:
        """Yield the descriptions of the recording, then blocks of messages. Each declares its own prefixes."""
        syntax = self.target.syntax
        to_bytes = writer(syntax, lifting)
        if part.start == 0:
            yield map(to_bytes.document, lifting.descriptions())
        for start in range(part.start, part.end, block):
            if syntax in (Syntax.TURTLE, Syntax.TRIG):
                to_bytes = writer(syntax, lifting)
            criteria = self.selection.criteria(lifting.recording, start, min(start + block, part.end))
            yield map(to_bytes.message, lifting.messages(criteria))


def lift(
    inputs: Sequence[str], output: Path, job: LiftJob, types: Sequence[Path], workers: int | None, dask: str | None
) -> None:
    """Write recordings to `output` (`-`: stdout). Raises Failure if not all parts could be written."""
    sources = find_sources(inputs)
    with user_errors(), ended_by_signals(), _draft_folder(output) as folder:
        texts = read_types(types)
        with output_errors():
            manifest = Manifest(folder, sources, texts, job)
        try:
            with Pool(worker_count(workers, sources), dask) as pool:
                joined = _Joined(manifest, sys.stdout.buffer if str(output) == "-" else None)
                run = run_parts(job, sources, texts, pool, manifest, joined.append)
        except Failure:
            if not manifest.done:
                manifest.remove()
            raise
        finally:
            manifest.close()
        if not run.report(sources):
            words = f"{output} is not complete; the same command computes the parts that are missing"
            raise Failure(words, ExitCode.INCOMPLETE)
        joined.finish(output)
        manifest.remove()
        if run.unreadable:
            raise Failure(f"{len(run.unreadable)} of {len(sources)} recordings are left out", ExitCode.INCOMPLETE)


def worker_count(workers: int | None, sources: Sequence[Source]) -> int:
    """Return the number of workers: that of the option, else one per core, or one for small recordings."""
    if workers is not None:
        return workers
    return usable_cores() if sum(source.size for source in sources) > SMALL else 1


@contextmanager
def ended_by_signals() -> Iterator[None]:
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


@contextmanager
def _draft_folder(output: Path) -> Iterator[Path]:
    """Yield the folder for the parts of an output, a temporary one for stdout."""
    if str(output) != "-":
        yield output.with_name(f".{output.name}.parts")
        return
    with tempfile.TemporaryDirectory(prefix="rosld-") as folder:
        yield Path(folder)


class _Joined:
    """The finished parts in order: in a file that replaces the output at the end, or on stdout."""

    def __init__(self, manifest: Manifest, stdout: BinaryIO | None) -> None:
        """Continue after the parts that were joined before."""
        self._manifest = manifest
        self._stdout = stdout
        self._file: BinaryIO = stdout or manifest.joined_file.open("ab")
        if stdout is None:
            self._file.truncate(manifest.size)

    def append(self, part: Part) -> None:
        """Append a part, and remove it."""
        folder = self._manifest.folder / part.folder
        with (folder / _LIFTED).open("rb") as lifted:
            shutil.copyfileobj(lifted, self._file, _BUFFER)
        self._file.flush()
        if self._stdout is None:
            self._manifest.note(joined=part, size=self._file.tell())
        shutil.rmtree(folder)

    def finish(self, output: Path) -> None:
        """Replace the output. The file is on the disk by then."""
        if self._stdout is None:
            os.fsync(self._file.fileno())
            self._file.close()
            self._manifest.joined_file.replace(output)
