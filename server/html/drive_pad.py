"""The pad that drives a robot: the configuration of its script. Pure."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from decimal import Decimal

import numpy as np
from msgspec import Struct, to_builtins
from pyoxigraph import Literal

from rosld.adapters.model import MessageSchema, Primitive
from rosld.ontology.fields import type_at
from rosld.ontology.neutral_message import COMMANDS
from rosld.server.html.bounds import parse_number
from rosld.server.html.inputs import Json
from rosld.shapes.value import UNBOUNDED, Bounds

RATE = 20.0
"""Rate in Hz at which commands are published while the pad is pressed."""
LEASE = 0.6
"""Seconds after which the robot stops if the page or the connection is lost."""
_WITHIN = Decimal("0.999")
"""Fraction of an exclusive bound that is used as the maximum."""


class Axis(Struct, frozen=True):
    """One direction of the pad: the path of its field, its label, its unit and its range."""

    path: str
    label: str
    unit: str
    least: float
    greatest: float


class DrivePad(Struct, frozen=True):
    """A pad for a topic: forward and leftward speeds, the message for standstill, and the terms of its hold."""

    topic: str
    ahead: Axis
    left: Axis
    zero: Json
    rate: float
    lease: float
    path: str = ""
    """The path of the topic's URL; empty for the URL of the page."""

    @property
    def json(self) -> str:
        """The configuration of the script, as JSON."""
        return json.dumps(to_builtins(self))


_SPEED = Axis("linear.x", "Speed", "m/s", -1.0, 1.0)
_TURN = Axis("angular.z", "Turn", "rad/s", -2.0, 2.0)
_CAR_SPEED = Axis("speed", "Speed", "m/s", -1.0, 1.0)
_STEERING = Axis("steering_angle", "Steering", "rad", -0.6, 0.6)
_AXES: Mapping[str, tuple[str, Axis, Axis]] = {
    "geometry_msgs/msg/Twist": ("", _SPEED, _TURN),
    "geometry_msgs/msg/TwistStamped": ("twist.", _SPEED, _TURN),
    "ackermann_msgs/msg/AckermannDrive": ("", _CAR_SPEED, _STEERING),
    "ackermann_msgs/msg/AckermannDriveStamped": ("drive.", _CAR_SPEED, _STEERING),
}
"""Prefix of the field paths, and the axes with their default ranges, by message type."""
assert _AXES.keys() == COMMANDS


def drive_pad(
    topic: str, schema: MessageSchema, bounds: Mapping[str, Bounds], zero: Json, max_rate: float
) -> DrivePad | None:
    """Return the pad for a topic of a type, within the bounds of its fields; None for other types."""
    found = _AXES.get(schema.ref.name)
    if found is None:
        return None
    prefix, ahead, left = found
    first, second = (_bound_axis(axis, prefix, schema, bounds) for axis in (ahead, left))
    return DrivePad(topic, first, second, zero, min(RATE, max_rate), LEASE)


def _bound_axis(axis: Axis, prefix: str, schema: MessageSchema, bounds: Mapping[str, Bounds]) -> Axis:
    path = prefix + axis.path
    demanded, is_single = bounds.get(path, UNBOUNDED), type_at(schema, path) == Primitive("float32")
    lower = [bound for bound in (_value(demanded.minimum), _within(demanded.exclusive_minimum)) if bound is not None]
    upper = [bound for bound in (_value(demanded.maximum), _within(demanded.exclusive_maximum)) if bound is not None]
    least = max(lower, default=Decimal(str(axis.least)))
    greatest = min(upper, default=Decimal(str(axis.greatest)))
    return Axis(
        path,
        axis.label,
        axis.unit,
        _inside(least, math.inf, is_single=is_single),
        _inside(greatest, -math.inf, is_single=is_single),
    )


def _value(bound: Literal | None) -> Decimal | None:
    return None if bound is None else parse_number(bound.value)


def _within(bound: Literal | None) -> Decimal | None:
    found = _value(bound)
    return None if found is None else found * _WITHIN


def _inside(bound: Decimal, inward: float, *, is_single: bool) -> float:
    """Return the number of the field's type nearest to a bound and within it (`0.1` has no exact representation)."""
    kind = np.float32 if is_single else np.float64
    nearest = kind(bound)
    is_outside = Decimal(float(nearest)) < bound if inward > 0 else Decimal(float(nearest)) > bound
    return float(np.nextafter(nearest, kind(inward)) if is_outside else nearest)
