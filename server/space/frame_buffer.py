"""Frames of a robot: the recent transforms of `/tf` and `/tf_static`, their tree, and look-ups."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence

from msgspec import Struct, field

from rosld.adapters.model import Message, Sample
from rosld.server.space.transform import (
    IDENTITY,
    Fields,
    Transform,
    compose,
    frame_name,
    interpolate,
    invert,
    is_rotation_set,
    read_rotation,
    read_stamp,
    read_vector,
)

STATIC_TOPIC = "/tf_static"
TOPICS = ("/tf", STATIC_TOPIC)
TYPES = frozenset({"tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"})
KEPT_NS = 10_000_000_000
"""Age of the oldest stored transforms, which is tf2's default."""
MAX_FRAMES = 2000
_MAX_TRANSFORMS = 2000
"""Maximum number of transforms per frame: 10 s at 200 Hz."""
_FIRST_CHOICES = ("map", "odom", "world", "earth")
"""Preferred fixed frames of a view (REP 105), the best first."""


_ALL_ZERO = "Its quaternion is all zero: it is drawn here without rotation, but tf2 ignores the transform"


class NoTransform(LookupError):
    """Reason why there is no transform between two frames: a sentence without its full stop."""


class FrameTransform(Struct, frozen=True):
    """A received transform: the pose of a frame in its parent at a time.

    `source` is the message that contained it, without its data.
    """

    parent: str
    child: str
    stamp_ns: int
    transform: Transform
    is_static: bool
    source: Sample


class _History(Struct):
    """Transforms of one frame by their stamps, in ascending order."""

    stamps: list[int] = field(default_factory=list)
    transforms: list[FrameTransform] = field(default_factory=list)

    @property
    def newest(self) -> FrameTransform:
        return self.transforms[-1]

    def add(self, each: FrameTransform) -> None:
        """Add a transform. A much older stamp means that time was reset (a recording's loop): drop the others."""
        if each.is_static or (self.stamps and each.stamp_ns < self.stamps[-1] - KEPT_NS):
            self.stamps, self.transforms = [], []
        place = bisect_right(self.stamps, each.stamp_ns)
        if place and self.stamps[place - 1] == each.stamp_ns:
            self.transforms[place - 1] = each
            return
        self.stamps.insert(place, each.stamp_ns)
        self.transforms.insert(place, each)
        old = bisect_right(self.stamps, self.stamps[-1] - KEPT_NS - 1)
        old = max(old, len(self.stamps) - _MAX_TRANSFORMS)
        if old > 0:
            del self.stamps[:old], self.transforms[:old]

    def at(self, stamp_ns: int | None) -> tuple[str, Transform]:
        """Return parent and transform at a time: interpolated, or the nearest one outside of the stored time."""
        place = len(self.stamps) if stamp_ns is None else bisect_right(self.stamps, stamp_ns)
        if place == len(self.stamps) or place == 0 or stamp_ns is None:
            found = self.transforms[max(place - 1, 0)]
            return found.parent, found.transform
        before, after = self.transforms[place - 1], self.transforms[place]
        if before.parent != after.parent:
            return before.parent, before.transform
        share = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
        return before.parent, interpolate(before.transform, after.transform, share)


class FrameBuffer:
    """All frames. `problems` are the problems of frames' latest transforms, mostly why they were rejected.

    `version` increases whenever a transform is added.
    """

    def __init__(self) -> None:
        self._histories: dict[str, _History] = {}
        self.problems: dict[str, str] = {}
        self.version = 0

    def add(self, message: Message, sample: Sample, *, is_static: bool) -> None:
        """Add the transforms of a tf2_msgs/TFMessage. Never raises because of its contents."""
        source = sample._replace(data=b"")
        transforms: Iterable[Fields] = getattr(message, "transforms", ())
        for each in transforms:
            child = ""
            try:
                child, parent = frame_name(each.child_frame_id), frame_name(each.header.frame_id)
                self._add(_read(each, parent, child, source, is_static=is_static))
                self.problems.pop(child, None)
                if not is_rotation_set(each.transform.rotation):
                    self._report(child, _ALL_ZERO)
            except (AttributeError, TypeError, ValueError, OverflowError) as error:
                self._report(child, str(error))
        self.version += 1

    def _add(self, each: FrameTransform) -> None:
        history = self._histories.get(each.child)
        if history is None:
            if len(self._histories) >= MAX_FRAMES:
                raise ValueError(f"There are more than {MAX_FRAMES:,} frames")
            history = self._histories[each.child] = _History()
        history.add(each)

    def _report(self, child: str, why: str) -> None:
        if len(self.problems) < MAX_FRAMES:
            self.problems[child] = why

    @property
    def newest(self) -> Mapping[str, FrameTransform]:
        """Newest transform of each frame with a parent."""
        return {child: history.newest for child, history in self._histories.items()}

    def newest_of(self, name: str) -> FrameTransform | None:
        """Return the newest transform of a frame, or None if it has no parent."""
        history = self._histories.get(name)
        return None if history is None else history.newest

    def sources_of(self, name: str) -> Collection[tuple[str, str]]:
        """Return the publishers and parents of a frame's stored transforms."""
        history = self._histories.get(name)
        return {(each.source.publisher, each.parent) for each in history.transforms} if history else set()

    @property
    def names(self) -> Collection[str]:
        """All frames, including those that are only parents, in ascending order of names."""
        parents = {history.newest.parent for history in self._histories.values()}
        return sorted(parents | self._histories.keys())

    @property
    def roots(self) -> Sequence[str]:
        """Frames without a parent, those with the most frames below them first."""
        sizes: dict[str, int] = {}
        for name in self.names:
            *_, (root, _) = self._upwards(name, None)
            sizes[root] = sizes.get(root, 0) + 1
        return sorted(sizes, key=lambda name: (-sizes[name], name))

    def default_frame(self) -> str | None:
        """Return the default fixed frame of a view; None without frames."""
        names = self.names
        return next((each for each in _FIRST_CHOICES if each in names), None) or next(iter(self.roots), None)

    def look_up(self, target: str, source: str, stamp_ns: int | None = None) -> Transform:
        """Return the transform from `source` to `target` at a time (None: the newest). Raises NoTransform."""
        target, source = frame_name(target), frame_name(source)
        if target == source:
            return IDENTITY
        if not self._histories and not self.problems:
            raise NoTransform(f"No transforms say where {_quoted(source) or 'the frame without a name'} is")
        for name in (target, source):
            self._require(name)
        above = dict(self._upwards(source, stamp_ns))
        for name, transform in self._upwards(target, stamp_ns):
            if name in above:
                return compose(invert(transform), above[name])
        raise NoTransform(f"{_quoted(source)} and {_quoted(target)} are in different trees, which are not connected")

    def _require(self, name: str) -> None:
        if name in self._histories or any(each.newest.parent == name for each in self._histories.values()):
            return
        if not name:
            raise NoTransform("The message names no frame")
        why = f": {self.problems[name]}" if name in self.problems else ""
        raise NoTransform(f"There is no frame called {_quoted(name)}{why}")

    def _upwards(self, name: str, stamp_ns: int | None) -> Iterator[tuple[str, Transform]]:
        """Yield a frame and its ancestors, each with the transform from the frame to it; stop at a cycle."""
        transform, passed = IDENTITY, {name}
        yield name, transform
        while (history := self._histories.get(name)) is not None:
            name, own = history.at(stamp_ns)
            if name in passed:
                return
            transform = compose(own, transform)
            passed.add(name)
            yield name, transform


def _read(each: Fields, parent: str, child: str, source: Sample, *, is_static: bool) -> FrameTransform:
    """Return a geometry_msgs/TransformStamped. Raises ValueError with a sentence."""
    if not child or not parent:
        raise ValueError("A transform names no frame")
    if child == parent:
        raise ValueError(f"{_quoted(child)} is said to be its own parent")
    own = each.transform
    transform = Transform(read_vector(own.translation), read_rotation(own.rotation))
    return FrameTransform(parent, child, read_stamp(each.header), transform, is_static, source)


def _quoted(name: str) -> str:
    return name[:80] if name.isprintable() else repr(name[:80])


OLD_NS = 10_000_000_000
"""Age of the last transform above which moving frames are marked as old: tf2 has dropped them."""


class FrameNode(Struct, frozen=True):
    """A frame in its tree: its depth, newest transform (None for a root), publishers, and problem."""

    name: str
    depth: int
    newest: FrameTransform | None
    publishers: tuple[str, ...] = ()
    problem: str = ""


def frame_tree(buffer: FrameBuffer, age_ns: Callable[[Sample], int]) -> list[FrameNode]:
    """Return all frames, parents before children, the largest tree first; last those with only rejected transforms."""
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
        words.append(f"It is its own ancestor, through {newest.parent}")
    if not newest.is_static and age_ns(newest.source) > OLD_NS:
        words.append("It moves, but no transform was received for 10 s")
    if len(parents) > 1:
        words.append(f"It has several parents: {', '.join(parents)}")
    if len(publishers) > 1:
        words.append("Several nodes publish its transform")
    return FrameNode(name, depth, newest, publishers, ". ".join(words))
