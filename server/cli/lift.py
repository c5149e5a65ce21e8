"""`rosld lift`: convert recordings to one file of RDF, or send them to a store, in parts and in parallel."""

from __future__ import annotations

import gzip
import os
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO

from msgspec import Struct

from rosld.adapters.base import Recording
from rosld.ontology.lift import LiftSettings
from rosld.ontology.syntax import Syntax
from rosld.ontology.urls import Space
from rosld.server.cli.conversion import Manifest, Output, Run, convert
from rosld.server.cli.parts import Job, Outcome, Part
from rosld.server.cli.rdf_writer import Lifting, writer
from rosld.server.cli.recording_inputs import Source

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
        return Outcome(lifting.selected, dict(lifting.unread))

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
    inputs: Sequence[str], types: Sequence[Path], job: LiftJob, output: Path, workers: int | None, dask: str | None
) -> None:
    """Write recordings to a file, or to stdout (`-`). Raises Failure."""
    if str(output) != "-":
        convert(inputs, types, job, FileOutput(output), output.with_name(f".{output.name}.parts"), workers, dask)
        return
    with tempfile.TemporaryDirectory(prefix="rosld-") as folder:
        convert(inputs, types, job, Stdout(), Path(folder, "parts"), workers, dask)


class Stdout(Output):
    """The parts in order on stdout."""

    name = "stdout"

    def begin(self, manifest: Manifest, sources: Sequence[Source]) -> None:
        self._folder = manifest.folder
        self._file: BinaryIO = sys.stdout.buffer

    def add(self, part: Part) -> None:
        folder = self._folder / part.folder
        with (folder / _LIFTED).open("rb") as lifted:
            shutil.copyfileobj(lifted, self._file, _BUFFER)
        self._file.flush()
        shutil.rmtree(folder)


class FileOutput(Stdout):
    """The parts in order in a file, which replaces the output once it is complete."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.name = str(path)

    def begin(self, manifest: Manifest, sources: Sequence[Source]) -> None:
        super().begin(manifest, sources)
        self._manifest = manifest
        self._file = manifest.joined_file.open("ab")
        self._file.truncate(manifest.size)

    def add(self, part: Part) -> None:
        super().add(part)
        self._manifest.note(joined=part, size=self._file.tell())

    def finish(self, run: Run) -> None:
        os.fsync(self._file.fileno())
        self._file.close()
        self._manifest.joined_file.replace(self._path)
