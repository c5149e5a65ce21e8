"""Reading the fields of messages, whatever ROS they are of: frames, stamps, vectors. Pure."""

from __future__ import annotations

import math
from typing import Any, TypeAlias

from rosld.server.space.transform import Quaternion, Transform, Vector, unit_quaternion

Fields: TypeAlias = Any
"""A message, or a part of one: which fields it has is known once it is read. A missing one is an AttributeError."""
MAX_COORDINATE = 1e9
"""Metres: what is farther is no place."""


def frame_name(text: object) -> str:
    """A frame without the slash that it begins with in the first tf. Raises ValueError for what is no name."""
    name = str(text).removeprefix("/")
    if len(name) > 300:
        raise ValueError(f"A name of {len(name):,} characters is none of a frame")
    return name.encode("utf-8", "replace").decode()


def read_stamp(header: Fields) -> int:
    """The stamp of a std_msgs/Header in nanoseconds, 0 where there is none."""
    stamp = getattr(header, "stamp", None)
    return int(getattr(stamp, "sec", 0)) * 1_000_000_000 + int(getattr(stamp, "nanosec", 0))


def read_vector(message: Fields) -> Vector:
    """x, y and z of a geometry_msgs/Vector3 or Point. Raises ValueError where they are no place."""
    found = float(message.x), float(message.y), float(message.z)
    require_place(*found)
    return found


def require_place(*numbers: float) -> None:
    """Raise ValueError where a number is none, or too large to be a place."""
    for each in numbers:
        if not math.isfinite(each) or abs(each) > MAX_COORDINATE:
            raise ValueError(f"{each:g} is no coordinate")


def read_pose(pose: Fields) -> Transform:
    """A geometry_msgs/Pose. Raises ValueError: NoRotation for a quaternion that is none."""
    return Transform(read_vector(pose.position), read_rotation(pose.orientation))


def read_rotation(quaternion: Fields) -> Quaternion:
    """A geometry_msgs/Quaternion. Raises NoRotation."""
    return unit_quaternion(*(float(getattr(quaternion, axis)) for axis in "xyzw"))


def is_rotation_set(quaternion: Fields) -> bool:
    """Whether a geometry_msgs/Quaternion is other than all zero, as messages of ROS 1 begin."""
    return any(getattr(quaternion, axis) for axis in "xyzw")
