"""Recordings named on the command line: files, folders and URLs, opened in whichever process reads them."""

from __future__ import annotations

import tempfile
import threading
from collections import Counter, OrderedDict
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from fnmatch import fnmatchcase
from importlib import import_module
from itertools import chain, count
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import urlsplit
from urllib.request import url2pathname

from msgspec import Struct
from msgspec.structs import replace

from rosld.adapters.base import FOR_EVER, Adapter, AdapterOptions, MessageFilter, Recording
from rosld.adapters.model.moment import Moment
from rosld.server.cli.failure import ExitCode, Failure, user_errors
from rosld.server.cli.list_types import open_source

_COMPRESSIONS = (".zst", ".zstd")
_SUFFIXES = (".bag", ".mcap", ".db3")
_FILES = tuple(f"{suffix}{packed}" for suffix in _SUFFIXES for packed in ("", *_COMPRESSIONS))
_METADATA = "metadata.yaml"
_OPEN = 4
"""Maximum number of recordings that a thread keeps open: 40 bytes of memory per message, and up to 64 MB each."""
_DEFINITIONS = (".msg", ".srv", ".action", ".idl")

TypeTexts = tuple[tuple[str, str], ...]
"""Files of `--types` folders: their relative paths and texts, for processes that cannot read the folders."""


class Source(Struct, frozen=True):
    """A recording: absolute path or URL, name, size in bytes, and a stamp that changes with its content."""

    location: str
    name: str
    size: int
    stamp: str

    @property
    def is_remote(self) -> bool:
        """Whether the location is a URL."""
        return "://" in self.location


class Selection(Struct, frozen=True):
    """Selected messages: globs of topics (none: all), and first and last time."""

    topics: tuple[str, ...] = ()
    begin: Moment | None = None
    end: Moment | None = None

    def topics_of(self, recording: Recording) -> frozenset[str] | None:
        """Return the selected topics of a recording, None for all."""
        if not self.topics:
            return None
        globs = [glob if glob.startswith(("/", "*")) else f"/{glob}" for glob in self.topics]
        return frozenset(name for name in recording.topics if any(fnmatchcase(name, glob) for glob in globs))

    def criteria(self, recording: Recording, start: int, end: int) -> MessageFilter:
        """Return the filter for the selected messages with numbers from `start` to `end` (exclusive)."""
        first, last = recording.start_ns, recording.end_ns
        return MessageFilter(
            self.topics_of(recording),
            0 if self.begin is None else self.begin.at(first, last),
            FOR_EVER if self.end is None else self.end.at(first, last),
            start,
            end,
        )


def find_sources(inputs: Sequence[str]) -> list[Source]:
    """Return the recordings of these files, folders and URLs, each once, in this order. Raises Failure.

    A rosbag2 folder is one recording; of any other folder, every recording below it is one. Names are those that a
    server of the folder gives them.
    """
    found: dict[str, tuple[Source, str]] = {}
    for each in inputs:
        with user_errors():
            below = list(_remote(each) if _is_remote(each) else _local(each))
        if not below:
            raise Failure(f"{each}: there is no recording ({', '.join(_SUFFIXES)}) in this folder", ExitCode.INPUT)
        found |= {source.location: (source, folder) for source, folder in below}
    counts = Counter(source.name for source, _ in found.values())
    taken: set[str] = set()
    named: list[Source] = []
    for source, folder in found.values():
        longer = [f"{folder}-{each}" if folder else each for each in (source.name, PurePosixPath(source.location).name)]
        names = [*([source.name] if counts[source.name] == 1 else []), *longer]
        free = (each for each in chain(names, (f"{names[-1]}-{number}" for number in count(2))) if each not in taken)
        named.append(replace(source, name=next(free)))
        taken.add(named[-1].name)
    return named


def read_types(folders: Iterable[Path]) -> TypeTexts:
    """Return the type definitions in these folders. Raises OSError."""
    return tuple(
        (f"{number}/{folder.resolve().name}/{path.relative_to(folder).as_posix()}", path.read_text("utf-8", "replace"))
        for number, folder in enumerate(folders)
        for path in sorted(folder.rglob("*"))
        if path.suffix in _DEFINITIONS and path.is_file()
    )


class _Open(threading.local):
    """The open recordings of a thread, the most recently used last; and folders with type definitions."""

    def __init__(self) -> None:
        self.adapters: OrderedDict[tuple[Source, TypeTexts], tuple[Adapter, ExitStack]] = OrderedDict()
        self.types: dict[TypeTexts, tempfile.TemporaryDirectory[str]] = {}


_open = _Open()


def open_recording(source: Source, types: TypeTexts) -> tuple[Recording, bool]:
    """Return a recording and whether its time is simulated. It stays open until this thread has opened some others.

    Raises the adapter's errors, OSError and ValueError.
    """
    key = (source, types)
    if key not in _open.adapters:
        while len(_open.adapters) >= _OPEN:
            _open.adapters.popitem(last=False)[1][1].close()
        _open.adapters[key] = _opened(source, types)
    _open.adapters.move_to_end(key)
    adapter = _open.adapters[key][0]
    (recording,) = adapter.recordings.values()
    return recording, adapter.graph.simulated_time


def close_recordings() -> None:
    """Close all recordings that this thread has opened."""
    while _open.adapters:
        _open.adapters.popitem()[1][1].close()
    while _open.types:
        _open.types.popitem()[1].cleanup()


def _opened(source: Source, types: TypeTexts) -> tuple[Adapter, ExitStack]:
    options = AdapterOptions(types=_types_folder(types), recording_name=source.name)
    with ExitStack() as stack, _local_copy(source) as path:
        # An open file can be read after its temporary copy is removed, which even a killed process leaves behind.
        adapter = stack.enter_context(open_source(f"recording:{path}", options))
        return adapter, stack.pop_all()
    raise AssertionError


def _types_folder(types: TypeTexts) -> tuple[Path, ...]:
    if not types:
        return ()
    if types not in _open.types:
        folder = _open.types[types] = tempfile.TemporaryDirectory(prefix="rosld-types-")
        for name, text in types:
            path = Path(folder.name, name)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, "utf-8")
    return (Path(_open.types[types].name),)


@contextmanager
def _local_copy(source: Source) -> Iterator[Path]:
    """Yield the path of a recording, or that of a temporary copy if it is remote."""
    if not source.is_remote:
        yield Path(source.location)
        return
    files, path = _file_system(source.location)
    with tempfile.TemporaryDirectory(prefix="rosld-") as folder:
        target = Path(folder, PurePosixPath(path).name)
        files.get(path, str(target), recursive=files.isdir(path))
        yield target


def _is_remote(location: str) -> bool:
    return "://" in location and not location.startswith("file://")


def _file_system(url: str) -> tuple[Any, str]:
    """Return the file system of a URL and the path there. Raises Failure."""
    try:
        core = import_module("fsspec.core")
    except ImportError as error:
        raise Failure(f"{url}: URLs of recordings need fsspec: pip install 'rosld[files]'") from error
    try:
        files, path = core.url_to_fs(url)
    except ImportError as error:
        raise Failure(f"{url}: {error}") from error
    return files, path


def _local(location: str) -> Iterator[tuple[Source, str]]:
    """Yield the recordings at a path, each with the folders between. Raises Failure."""
    path = Path(url2pathname(urlsplit(location).path) if location.startswith("file://") else location)
    path = path.expanduser().resolve()
    if not path.exists():
        raise Failure(f"there is no recording {location!r}", ExitCode.INPUT)
    below = [each.as_posix() for each in path.rglob("*") if each.is_file()] if path.is_dir() else [path.as_posix()]
    for found, files in _recordings_among(path.as_posix(), below):
        states = [Path(each).stat() for each in files]
        stamp = max(each.st_mtime_ns for each in states)
        source = Source(found, _name(found, files), sum(each.st_size for each in states), str(stamp))
        yield source, _folder(path.as_posix(), found)


def _remote(url: str) -> Iterator[tuple[Source, str]]:
    """Yield the recordings at a URL, each with the folders between. Raises Failure."""
    files, path = _file_system(url)
    try:
        details = {path: files.info(path)} if files.isfile(path) else files.find(path, detail=True)
    except Exception as error:  # each file system raises its own
        raise Failure(f"{url}: {error or type(error).__name__}", ExitCode.INPUT) from error
    for found, members in _recordings_among(path, sorted(details)):
        states = [details[each] for each in members]
        stamps = [str(each.get("ETag") or each.get("mtime") or each.get("LastModified") or "") for each in states]
        size = sum(int(each.get("size") or 0) for each in states)
        source = Source(files.unstrip_protocol(found), _name(found, members), size, " ".join(stamps))
        yield source, _folder(path, found)


def _recordings_among(top: str, paths: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
    """Yield the recordings among the files below `top`, each with its files, sorted."""
    members: dict[str, set[str]] = {}
    for path in paths:
        members.setdefault(path.rpartition("/")[0], set()).add(path.rpartition("/")[2])
    folders = {folder for folder, names in members.items() if _is_one(folder.rpartition("/")[2], names)}
    grouped: dict[str, list[str]] = {}
    for path in sorted(paths):
        folder = path.rpartition("/")[0]
        hidden = any(part.startswith(".") for part in path[len(top) :].split("/"))
        if folder in folders and path != top:
            grouped.setdefault(folder, []).append(path)
        elif path == top or (path.endswith(_FILES) and not hidden):
            grouped[path] = [path]
    yield from sorted(grouped.items())


def _is_one(folder: str, names: Collection[str]) -> bool:
    """Whether a folder is a ROS 2 bag: it has metadata, or only the parts `FOLDER_0.mcap`, `FOLDER_1.mcap`, ..."""
    recorded = {each for each in names if each.endswith(_FILES)}
    return _METADATA in names or any(
        recorded == {f"{folder}_{number}{suffix}" for number in range(len(recorded))} != set() for suffix in _FILES
    )


def _name(path: str, files: Sequence[str]) -> str:
    """Return the name of a recording: that of its folder, or of its file without suffixes (`x` for `x.bag.active`)."""
    name = path.rpartition("/")[2]
    for suffix in (*_COMPRESSIONS, ".active"):
        name = name.removesuffix(suffix) if files == [path] else name
    return (PurePosixPath(name).stem if files == [path] else name) or "recording"


def _folder(top: str, path: str) -> str:
    """Return the folders between `top` and a recording, joined by hyphens."""
    return "-".join(path[len(top) :].strip("/").split("/")[:-1])
