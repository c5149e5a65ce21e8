"""Rigid transforms, and frames: the recent transforms of `/tf` and `/tf_static`, their tree, and look-ups."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

from msgspec import Struct, field

from rosld.adapters.model import Encoding, Message, Sample, TypeRef

Vector: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]
"""x, y, z, w."""
_SHORTEST = 1e-6
"""Length of a quaternion below which it is invalid, unless it is all zero."""
_ALMOST_EQUAL = 1 - 1e-9
"""Cosine of half the angle above which slerp divides by almost zero."""


class NoRotation(ValueError):
    """Numbers that are not a rotation; the message is a sentence without its full stop."""


class Transform(NamedTuple):
    """Transform of a child frame in its parent: maps coordinates in the child to those in the parent."""

    translation: Vector
    rotation: Quaternion


IDENTITY = Transform((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


def unit_quaternion(x: float, y: float, z: float, w: float) -> Quaternion:
    """Return the normalized quaternion. Raises NoRotation.

    All zero, as in an uninitialized message, is the identity, as in RViz.
    """
    if not (x or y or z or w):
        return IDENTITY.rotation
    length = math.sqrt(x * x + y * y + z * z + w * w)
    if not math.isfinite(length) or length < _SHORTEST:
        raise NoRotation(f"The quaternion ({x:g}, {y:g}, {z:g}, {w:g}) is not a rotation")
    return x / length, y / length, z / length, w / length


def multiply(one: Quaternion, other: Quaternion) -> Quaternion:
    """Return the rotation by `other`, then by `one` (Hamilton's product)."""
    ax, ay, az, aw = one
    bx, by, bz, bw = other
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def rotate(rotation: Quaternion, point: Vector) -> Vector:
    """Return a point rotated about the origin."""
    x, y, z, w = rotation
    px, py, pz = point
    # v + 2w(q x v) + 2q x (q x v)
    cx, cy, cz = 2 * (y * pz - z * py), 2 * (z * px - x * pz), 2 * (x * py - y * px)
    return (
        px + w * cx + y * cz - z * cy,
        py + w * cy + z * cx - x * cz,
        pz + w * cz + x * cy - y * cx,
    )


def apply(transform: Transform, point: Vector) -> Vector:
    """Return the parent coordinates of a point in child coordinates."""
    x, y, z = rotate(transform.rotation, point)
    dx, dy, dz = transform.translation
    return x + dx, y + dy, z + dz


def compose(outer: Transform, inner: Transform) -> Transform:
    """Return the transform that applies `inner`, then `outer`."""
    return Transform(apply(outer, inner.translation), multiply(outer.rotation, inner.rotation))


def invert(transform: Transform) -> Transform:
    """Return the transform from the parent to the child."""
    x, y, z, w = transform.rotation
    back = (-x, -y, -z, w)
    dx, dy, dz = rotate(back, transform.translation)
    return Transform((-dx, -dy, -dz), back)


def interpolate(first: Transform, second: Transform, share: float) -> Transform:
    """Return the transform at a share (0 to 1) of the way between two: linear translation, shortest rotation."""
    (ax, ay, az), (bx, by, bz) = first.translation, second.translation
    moved = (ax + (bx - ax) * share, ay + (by - ay) * share, az + (bz - az) * share)
    return Transform(moved, _slerp(first.rotation, second.rotation, share))


def heading(transform: Transform) -> float:
    """Return the angle about z in radians: the direction of the x axis, seen from above."""
    x, y, z, w = transform.rotation
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def _slerp(first: Quaternion, second: Quaternion, share: float) -> Quaternion:
    cosine = sum(a * b for a, b in zip(first, second, strict=True))
    sign = -1.0 if cosine < 0 else 1.0
    if abs(cosine) > _ALMOST_EQUAL:
        a, b = 1 - share, sign * share
    else:
        angle = math.acos(abs(cosine))
        a, b = math.sin((1 - share) * angle) / math.sin(angle), sign * math.sin(share * angle) / math.sin(angle)
    return unit_quaternion(*(a * one + b * other for one, other in zip(first, second, strict=True)))


Fields: TypeAlias = Any
"""A message or a part of one, with unknown fields. Reading a missing one raises AttributeError."""
MAX_COORDINATE = 1e9
"""Maximum coordinate in metres; greater ones are invalid."""


def frame_name(text: object) -> str:
    """Return a frame without its leading slash, which the first tf used. Raises ValueError for an invalid name."""
    name = str(text).removeprefix("/")
    if len(name) > 300:
        raise ValueError(f"A frame name cannot have {len(name):,} characters")
    return name.encode("utf-8", "replace").decode()


def read_stamp(header: Fields) -> int:
    """Return the stamp of a std_msgs/Header in nanoseconds, or 0."""
    stamp = getattr(header, "stamp", None)
    return int(getattr(stamp, "sec", 0)) * 1_000_000_000 + int(getattr(stamp, "nanosec", 0))


def read_vector(message: Fields) -> Vector:
    """Return x, y and z of a geometry_msgs/Vector3 or Point. Raises ValueError if they are invalid."""
    found = float(message.x), float(message.y), float(message.z)
    require_place(*found)
    return found


def require_place(*numbers: float) -> None:
    """Raise ValueError if a number is not finite, or too large for a coordinate."""
    for each in numbers:
        if not math.isfinite(each) or abs(each) > MAX_COORDINATE:
            raise ValueError(f"{each:g} is not a coordinate")


def read_pose(pose: Fields) -> Transform:
    """Return a geometry_msgs/Pose. Raises ValueError, which is NoRotation for an invalid quaternion."""
    return Transform(read_vector(pose.position), read_rotation(pose.orientation))


def read_rotation(quaternion: Fields) -> Quaternion:
    """Return a geometry_msgs/Quaternion. Raises NoRotation."""
    return unit_quaternion(*(float(getattr(quaternion, axis)) for axis in "xyzw"))


def is_rotation_set(quaternion: Fields) -> bool:
    """Whether a geometry_msgs/Quaternion is not all zero, the initial value in ROS 1."""
    return any(getattr(quaternion, axis) for axis in "xyzw")


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


FrameRow: TypeAlias = tuple[str, str, int, bool, Vector, Quaternion]
"""A transform as sent to another process: parent, child, stamp, whether it is static, translation and rotation."""
_NO_SAMPLE = Sample(b"", Encoding.CDR, TypeRef("tf2_msgs/msg/TFMessage"), "", 0, 0)


class _History(Struct):
    """Transforms of one frame by their stamps, in ascending order."""

    is_exact: bool
    stamps: list[int] = field(default_factory=list)
    transforms: list[FrameTransform] = field(default_factory=list)

    @property
    def newest(self) -> FrameTransform:
        return self.transforms[-1]

    def add(self, each: FrameTransform) -> None:
        """Add a transform. A much older stamp means that time was reset (a recording's loop): drop the others."""
        is_reset = bool(self.stamps) and not self.is_exact and each.stamp_ns < self.stamps[-1] - KEPT_NS
        if each.is_static or is_reset:
            self.stamps, self.transforms = [], []
        place = bisect_right(self.stamps, each.stamp_ns)
        if place and self.stamps[place - 1] == each.stamp_ns:
            self.transforms[place - 1] = each
            return
        self.stamps.insert(place, each.stamp_ns)
        self.transforms.insert(place, each)
        if self.is_exact:
            return
        old = bisect_right(self.stamps, self.stamps[-1] - KEPT_NS - 1)
        old = max(old, len(self.stamps) - _MAX_TRANSFORMS)
        if old > 0:
            del self.stamps[:old], self.transforms[:old]

    def at(self, stamp_ns: int | None) -> tuple[str, Transform] | None:
        """Return parent and transform at a time: interpolated, or the nearest one outside of the stored time.

        If look-ups are exact, there is none outside, nor between transforms that tf2 never has together.
        """
        place = len(self.stamps) if stamp_ns is None else bisect_right(self.stamps, stamp_ns)
        if self.is_exact and stamp_ns is not None and not self.newest.is_static:
            after_ns = self.stamps[min(place, len(self.stamps) - 1)]
            is_stored = place > 0 and self.stamps[place - 1] == stamp_ns
            if not is_stored and (place in (0, len(self.stamps)) or after_ns - self.stamps[place - 1] > KEPT_NS):
                return None
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

    `version` increases whenever a transform is added. An exact buffer keeps all transforms, and extrapolates none, as
    tf2 does; others are for views, in which an old place is better than none.
    """

    def __init__(self, *, is_exact: bool = False) -> None:
        self._is_exact = is_exact
        self._histories: dict[str, _History] = {}
        self.problems: dict[str, str] = {}
        self.version = 0

    @classmethod
    def of(cls, rows: Iterable[FrameRow]) -> FrameBuffer:
        """Return an exact buffer of the rows of others."""
        buffer = cls(is_exact=True)
        for parent, child, stamp, is_static, moved, turned in rows:
            buffer._add(FrameTransform(parent, child, stamp, Transform(moved, turned), is_static, _NO_SAMPLE))
        return buffer

    def rows(self) -> list[FrameRow]:
        """Return all transforms."""
        every = (each for history in self._histories.values() for each in history.transforms)
        return [(each.parent, each.child, each.stamp_ns, each.is_static, *each.transform) for each in every]

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
            history = self._histories[each.child] = _History(self._is_exact)
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
        """Return the transform from `source` to `target` at a time. Raises NoTransform.

        None is the newest transform of each frame, or in an exact buffer the latest time that all of them have.
        """
        target, source = frame_name(target), frame_name(source)
        if target == source:
            return IDENTITY
        if not self._histories and not self.problems:
            raise NoTransform(f"No transforms say where {_quoted(source) or 'the frame without a name'} is")
        for name in (target, source):
            self._require(name)
        if stamp_ns is None and self._is_exact:
            stamp_ns = self._latest_common_time(target, source)
        above = dict(self._upwards(source, stamp_ns))
        for name, transform in self._upwards(target, stamp_ns):
            if name in above:
                return compose(invert(transform), above[name])
        if self._is_exact:
            raise NoTransform(f"There is no path from {_quoted(source)} to {_quoted(target)} at that time")
        raise NoTransform(f"{_quoted(source)} and {_quoted(target)} are in different trees, which are not connected")

    def _latest_common_time(self, *names: str) -> int | None:
        """Return the earliest of the newest stamps between two frames; None if all of these are static."""
        above = [[name for name, _ in self._upwards(each, None)] for each in names]
        between = set(above[0]) ^ set(above[1])
        newest = (self._histories[name].newest for name in between if name in self._histories)
        return min((each.stamp_ns for each in newest if not each.is_static), default=None)

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
            found = history.at(stamp_ns)
            if found is None or found[0] in passed:
                return
            name, own = found
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
