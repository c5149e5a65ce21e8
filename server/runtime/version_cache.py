"""Versions of values and files, and a cache that finds an entry only at its version."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Generic, TypeVar

from msgspec import Struct, field

T = TypeVar("T")


class VersionCache(Struct, Generic[T]):
    """Values by key (usually a URL), each for one version of its sources; the oldest are removed first."""

    limit: int = 4096
    _entries: dict[Hashable, tuple[Hashable, T]] = field(default_factory=dict)

    def find(self, key: Hashable, version: Hashable) -> T | None:
        """Return the cached value of a key if it has this version, else None."""
        entry = self._entries.get(key)
        return entry[1] if entry is not None and entry[0] == version else None

    def put(self, key: Hashable, version: Hashable, value: T) -> T:
        """Cache a value and return it."""
        self._entries.pop(key, None)
        self._entries[key] = (version, value)
        if len(self._entries) > self.limit:
            self._entries.pop(next(iter(self._entries)), None)
        return value

    def clear(self) -> None:
        """Remove all values."""
        self._entries.clear()

    def get_or_make(self, key: Hashable, version: Hashable, make: Callable[[], T]) -> T:
        """Return the cached value of a key at this version, or create it."""
        found = self.find(key, version)
        return found if found is not None else self.put(key, version, make())


class IdentityKey:
    """Key that compares by identity: a version that is cheap to compare."""

    __slots__ = ("value",)

    def __init__(self, value: object) -> None:
        self.value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, IdentityKey) and other.value is self.value

    def __hash__(self) -> int:
        return id(self.value)


def file_version(path: Path) -> tuple[int, int, int]:
    """Return a version that changes whenever the file is written; a missing file has version zero."""
    try:
        found = path.stat()
    except OSError:
        return (0, 0, 0)
    return found.st_mtime_ns, found.st_size, found.st_ino
