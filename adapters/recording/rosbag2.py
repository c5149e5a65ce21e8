"""ROS 2 bags as folders: the files that `metadata.yaml` lists, or without it all that lie there, as one recording."""

from __future__ import annotations

import shutil
import tempfile
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import NamedTuple, TypeAlias

import numpy as np
from ruamel.yaml import YAML, events
from ruamel.yaml.error import YAMLError

from rosld.adapters.recording.byte_source import STEP, decompress_zstd, inflate_file
from rosld.adapters.recording.open_budget import OpenBudget
from rosld.adapters.recording.storage import Damaged, MessageTable, RecordedConnection, RosVersion, Storage, concatenate

METADATA = "metadata.yaml"
_RESERVE = 256 << 20
"""Bytes of the disk of the temporary files that are left to others."""
_MAX_BYTES = 2 * 1024 * 1024
"""Bytes of metadata: some 4,000 topics."""
_MAX_LEVELS = 20
_LONGEST_REASON = 200
_SUFFIXES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")


class Metadata(NamedTuple):
    """What concerns us of `metadata.yaml`: files, compression ("", "file", "message"), and each topic's type hash."""

    files: tuple[str, ...] = ()
    compression: str = ""
    hashes: Mapping[str, str] = {}


class Rosbag2:
    """An open folder of ROS 2 files: a `Storage` whose places are those of its files, one after the other."""

    silent: tuple[str, ...] = ()

    def __init__(self, folder: Path, open_file: Callable[[Path, OpenBudget], Storage], budget: OpenBudget) -> None:
        metadata, notes = _metadata(folder, budget)
        self._per_message = metadata.compression == "message"
        self._inflated: tempfile.TemporaryDirectory[str] | None = None
        self._files: list[Storage] = []
        paths = _files(folder, metadata)
        if not paths:
            raise Damaged(f"it holds neither {METADATA} nor .mcap nor .db3 files")
        for path in paths:
            try:
                budget.spend(parts=1)
                self._files.append(open_file(self._plain(path, budget), budget))
            except (Damaged, OSError) as error:
                notes.append(f"{path.name} is left out: {error}")
            except BaseException:
                self.close()
                raise
        if not self._files:
            self.close()
            raise Damaged("; ".join(notes))
        self.ros_version: RosVersion = self._files[0].ros_version
        self.format = f"ROS {self.ros_version} bag ({' + '.join(sorted({each.format for each in self._files}))})"
        self.connections = [_hash(each, metadata) for file in self._files for each in file.connections]
        self.notes = (*notes, *(note for file in self._files for note in file.notes))
        self._starts = np.cumsum([0, *(file.places for file in self._files)]).tolist()
        self.places = self._starts[-1]
        self.messages = self._join()

    def read(self, place: int, offset: int) -> bytes:
        """The bytes of the message there, decompressed where each message was compressed. Raises Damaged."""
        number = bisect_right(self._starts, place) - 1
        data = self._files[number].read(place - self._starts[number], offset)
        return decompress_zstd(data) if self._per_message else data

    def close(self) -> None:
        """Close all files, and remove what was decompressed."""
        for file in self._files:
            file.close()
        if self._inflated is not None:
            self._inflated.cleanup()
            self._inflated = None

    def _join(self) -> MessageTable:
        tables: list[MessageTable] = []
        first = 0
        for start, file in zip(self._starts, self._files, strict=False):
            found = file.messages
            connections = (found.connections + first).astype(np.int32)
            tables.append(found._replace(connections=connections, places=(found.places + start).astype(np.int32)))
            first += len(file.connections)
        return concatenate(tables)

    def _plain(self, path: Path, budget: OpenBudget) -> Path:
        """The file itself, or where it was compressed as a whole, a decompressed copy of it."""
        if path.suffix != ".zstd":
            return path
        if self._inflated is None:
            self._inflated = tempfile.TemporaryDirectory(prefix="rosld-")
        plain = Path(self._inflated.name) / path.stem
        budget.allow(path.stat().st_size)
        try:
            inflate_file(path, plain, lambda _: _require_room(plain.parent, budget))
        except BaseException:
            plain.unlink(missing_ok=True)
            raise
        return plain


def _require_room(folder: Path, budget: OpenBudget) -> None:
    """Raise Damaged before what a file inflates to fills the disk of the temporary files."""
    budget.work(STEP)
    if shutil.disk_usage(folder).free < _RESERVE:
        raise Damaged(
            f"it inflates to more than there is room for in {tempfile.gettempdir()}: give the environment variable "
            "TMPDIR a folder on a larger disk"
        )


def _metadata(folder: Path, budget: OpenBudget) -> tuple[Metadata, list[str]]:
    """What `metadata.yaml` says, and a note where it is missing or cannot be used."""
    path = folder / METADATA
    if not path.exists():
        return Metadata(), [f"it has no {METADATA}, so all its files were read"]
    try:
        information = _member(_yaml(path, budget), "rosbag2_bagfile_information")
        topics = [_member(each, "topic_metadata") for each in _list(_member(information, "topics_with_message_count"))]
        mode = _text(_member(information, "compression_mode")).lower()
        files = [PurePosixPath(_text(each)).name for each in _list(_member(information, "relative_file_paths"))]
    except (YAMLError, ValueError) as error:
        words = " ".join(str(error).split())[:_LONGEST_REASON]
        return Metadata(), [f"its {METADATA} cannot be read ({words}), so all its files were read"]
    hashes = {_text(_member(each, "name")): _text(_member(each, "type_description_hash")) for each in topics}
    return Metadata(tuple(files), mode if mode in ("file", "message") else "", hashes), []


_Yaml: TypeAlias = "str | list[_Yaml] | dict[str, _Yaml]"


def _yaml(path: Path, budget: OpenBudget) -> _Yaml:
    """The value of a YAML file, all scalars as text. Raises YAMLError, and ValueError for what metadata never has.

    That is more than `_MAX_BYTES`, deep nesting, and aliases, by which a short text says any amount.
    """
    if path.stat().st_size > _MAX_BYTES:
        raise ValueError(f"it has more than {_MAX_BYTES} bytes")
    root: list[_Yaml] = []
    above: list[list[_Yaml] | dict[str, _Yaml]] = [root]
    keys: list[str | None] = [None]
    for event in YAML(typ="safe", pure=True).parse(path.read_text("utf-8", "replace")):
        budget.work()
        if isinstance(event, events.AliasEvent):
            raise ValueError("it has aliases, which are not read here")
        if isinstance(event, events.CollectionEndEvent):
            above.pop()
            keys.pop()
        if not isinstance(event, events.ScalarEvent | events.CollectionStartEvent):
            continue
        value: _Yaml = []
        if isinstance(event, events.ScalarEvent):
            value = str(event.value)
        elif isinstance(event, events.MappingStartEvent):
            value = {}
        container = above[-1]
        if isinstance(container, list):
            container.append(value)
        elif keys[-1] is None and isinstance(value, str):
            keys[-1] = value
        elif (key := keys[-1]) is not None:
            container[key], keys[-1] = value, None
        else:
            raise ValueError("a key in it is no text")
        if not isinstance(value, str):
            above.append(value)
            keys.append(None)
            if len(above) > _MAX_LEVELS:
                raise ValueError(f"it nests deeper than {_MAX_LEVELS} levels")
    return root[0] if root else ""


def _member(value: _Yaml, name: str) -> _Yaml:
    """A member of a mapping, empty where it is missing. Raises ValueError for what is no mapping."""
    if not isinstance(value, dict):
        raise ValueError(f"{name} is looked for in what is no mapping")
    return value.get(name, "")


def _list(value: _Yaml) -> list[_Yaml]:
    return value if isinstance(value, list) else []


def _text(value: _Yaml) -> str:
    return value if isinstance(value, str) and value not in ("null", "~") else ""


def _files(folder: Path, metadata: Metadata) -> Sequence[Path]:
    if metadata.files:
        return [folder / name for name in metadata.files]
    return sorted(path for path in folder.iterdir() if path.name.endswith(_SUFFIXES) and path.is_file())


def _hash(connection: RecordedConnection, metadata: Metadata) -> RecordedConnection:
    return connection if connection.hash else connection._replace(hash=metadata.hashes.get(connection.topic) or None)
