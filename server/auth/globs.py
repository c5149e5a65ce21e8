"""Globs over the paths of one server, matched segment by segment. Pure.

`*` matches any characters of one segment, `**` any number of whole segments, including none. Paths are compared
decoded: percent-encoding is removed once from each segment, so that no spelling of a name escapes its rule, and an
encoded slash (`%2F`) is part of its segment. A final slash makes no difference.
"""

from __future__ import annotations

import re
from functools import cached_property, lru_cache
from typing import TypeAlias
from urllib.parse import unquote

from msgspec import Struct

from rosld.ontology.urls import Location, decode_segment

Path: TypeAlias = tuple[str, ...]
"""Decoded segments of a path below the base; the entry point has none."""
_ANY = "**"
_NOT_IN_PATHS = re.compile(r"[?#\[\]\x00-\x20\x7f]")


def path_at(location: Location) -> Path:
    """Return the path to which rules apply; a container has the path of its name."""
    return (location.kind, *location.segments) if location.kind else location.segments


class Glob(Struct, frozen=True, dict=True):
    """A glob such as `/topics/camera/**`. Raises ValueError with a sentence if it is invalid."""

    text: str

    def __post_init__(self) -> None:
        if not self.text.startswith("/"):
            raise ValueError(
                f"{self.text!r} must begin with a slash: globs are paths below the base, such as /topics/**"
            )
        if found := _NOT_IN_PATHS.search(self.text):
            raise ValueError(f"{self.text!r} contains {found[0]!r}: the only wildcards are * and **")
        assert self._parts is not None

    @cached_property
    def _parts(self) -> tuple[re.Pattern[str] | None, ...]:
        """A pattern for each segment, None for `**`."""
        segments = self.text.strip("/").split("/") if self.text.strip("/") else []
        if segments == ["ontology"]:
            segments.append(_ANY)  # its modules are parts of it
        return tuple(None if each == _ANY else self._part(each) for each in segments)

    def _part(self, segment: str) -> re.Pattern[str]:
        if _ANY in segment:
            raise ValueError(f"{self.text!r}: ** matches whole segments and must stand alone between slashes")
        if not segment:
            raise ValueError(f"{self.text!r} has an empty segment: write an empty part of a name as ~")
        if "*" not in segment:
            try:
                return re.compile(re.escape(decode_segment(segment)))
            except ValueError as error:
                raise ValueError(f"{self.text!r}: {error}") from error
        literal = (re.escape(unquote(each, errors="strict")) for each in segment.split("*"))
        return re.compile(".*".join(literal), re.DOTALL)

    def matches(self, path: Path) -> bool:
        """Whether the glob matches this path."""
        return len(self._parts) in self._states_after(path)

    def overlaps_subtree(self, path: Path) -> bool:
        """Whether the glob matches this path or may match one below."""
        return bool(self._states_after(path))

    def covers_subtree(self, path: Path) -> bool:
        """Whether the glob matches this path and everything below."""
        last = len(self._parts) - 1
        return last >= 0 and self._parts[last] is None and last in self._states_after(path)

    def _states_after(self, path: Path) -> frozenset[int]:
        """Return the possible positions in the glob after the path."""
        states = self._skip_any({0})
        for segment in path:
            after = set()
            for state in states:
                if state == len(self._parts):
                    continue
                part = self._parts[state]
                if part is None:
                    after.add(state)
                elif part.fullmatch(segment):
                    after.add(state + 1)
            states = self._skip_any(after)
            if not states:
                break
        return frozenset(states)

    def _skip_any(self, states: set[int]) -> set[int]:
        """Return these positions, and those after each `**`, which may match nothing."""
        found = set(states)
        for state in sorted(states):
            while state < len(self._parts) and self._parts[state] is None:
                state += 1
                found.add(state)
        return found


@lru_cache(maxsize=1024)
def _type_pattern(glob: str) -> re.Pattern[str]:
    return re.compile(".*".join(map(re.escape, glob.split("*"))), re.DOTALL)


def type_matches(glob: str, name: str) -> bool:
    """Whether a glob over message types (`sensor_msgs/msg/*`) matches a type; `*` matches any characters."""
    return _type_pattern(glob).fullmatch(name) is not None
