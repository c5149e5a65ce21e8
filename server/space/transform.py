"""Rigid transforms, and fields of messages that contain them. No I/O."""

from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeAlias

Vector: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]
"""x, y, z, w."""
_SHORTEST = 1e-6
"""Length of a quaternion below which it is invalid, unless it is all zero."""
_ALMOST_EQUAL = 0.9995
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
