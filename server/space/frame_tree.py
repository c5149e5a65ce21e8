"""The frames of a robot as trees: each below its parent, with what is odd about it in words. Pure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from rosld.adapters.model import Sample
from rosld.server.space.frame_buffer import FrameBuffer, FrameTransform

OLD_NS = 10_000_000_000
"""Frames that move are old when nothing was said of them for so long: then tf2 has forgotten them."""


@dataclass(frozen=True, slots=True)
class FrameNode:
    """A frame in its tree: how many are above it, its newest transform (None: a root), who says it, what is odd."""

    name: str
    depth: int
    newest: FrameTransform | None
    publishers: tuple[str, ...] = ()
    problem: str = ""


def frame_tree(buffer: FrameBuffer, age_ns: Callable[[Sample], int]) -> list[FrameNode]:
    """All frames, each before those below it, the largest tree first; last what was said and is no transform."""
    children: dict[str, list[str]] = {}
    for child, each in buffer.newest.items():
        children.setdefault(each.parent, []).append(child)
    found: list[FrameNode] = []
    passed: set[str] = set()
    for root in buffer.roots:
        waiting = [(root, 0)]
        while waiting:
            name, depth = waiting.pop()
            if name in passed:
                continue
            passed.add(name)
            found.append(_node(buffer, name, depth, age_ns))
            waiting += [(child, depth + 1) for child in sorted(children.get(name, ()), reverse=True)]
    refused = (name for name in sorted(buffer.problems) if name not in passed)
    return [*found, *(FrameNode(name, 0, None, (), buffer.problems[name]) for name in refused)]


def _node(buffer: FrameBuffer, name: str, depth: int, age_ns: Callable[[Sample], int]) -> FrameNode:
    newest = buffer.newest_of(name)
    if newest is None:
        return FrameNode(name, depth, None)
    sources = buffer.sources_of(name)
    publishers, parents = (tuple(sorted({each[part] for each in sources})) for part in (0, 1))
    words = []
    if name in buffer.problems:
        words.append(buffer.problems[name])
    if depth == 0:
        words.append(f"It is below itself, by way of {newest.parent}")
    if not newest.is_static and age_ns(newest.source) > OLD_NS:
        words.append("It moves, and nothing was said of it for 10 s")
    if len(parents) > 1:
        words.append(f"It has several parents: {', '.join(parents)}")
    if len(publishers) > 1:
        words.append("Several nodes say where it is")
    return FrameNode(name, depth, newest, publishers, ". ".join(words))
