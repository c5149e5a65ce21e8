"""Differential drive: step by step from a commanded velocity to the motion, and its battery. No I/O.

The base has no watchdog: it follows the last command until the next one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

from rosld.adapters.rover.world import World

RADIUS = 0.2
"""Metres from the centre of the rover to its rim."""
WHEEL_SEPARATION = 0.32
BRAKING = 10.0
"""Deceleration in metres per second squared: from its top speed it stops within a tenth of a second."""
_TURN_BRAKING = 25.0
_TURN_FACTOR = 2.0
"""Radians per second squared for each metre per second squared."""


class Velocity(NamedTuple):
    """Metres per second ahead, and radians per second counterclockwise."""

    speed: float = 0.0
    turn_rate: float = 0.0


STANDSTILL = Velocity()


class Limits(NamedTuple):
    """Maximum speeds of the drive, and its acceleration in metres per second squared."""

    speed: float
    turn_rate: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class Motion:
    """The position and motion of the rover, the distance driven, and whether an obstacle blocks it."""

    x: float = 0.0
    y: float = 0.0
    heading: float = 0.0
    velocity: Velocity = STANDSTILL
    driven: float = 0.0
    is_bumped: bool = False


def wheel_speeds(velocity: Velocity) -> tuple[float, float]:
    """Return the speeds of the left and of the right wheel on the ground."""
    half = velocity.turn_rate * WHEEL_SEPARATION / 2
    return velocity.speed - half, velocity.speed + half


def drive(motion: Motion, command: Velocity, limits: Limits, world: World, seconds: float) -> Motion:
    """Return the motion after a short time. An obstacle stops the rover, which can then turn and drive away."""
    speed = _approach(
        motion.velocity.speed, _clamp(command.speed, limits.speed), limits.acceleration * seconds, BRAKING * seconds
    )
    turn_rate = _approach(
        motion.velocity.turn_rate,
        _clamp(command.turn_rate, limits.turn_rate),
        limits.acceleration * _TURN_FACTOR * seconds,
        _TURN_BRAKING * seconds,
    )
    heading = motion.heading + turn_rate * seconds / 2
    x = motion.x + speed * math.cos(heading) * seconds
    y = motion.y + speed * math.sin(heading) * seconds
    is_bumped = bool(speed) and is_closer(world, motion, x, y)
    if is_bumped:
        x, y, speed = motion.x, motion.y, 0.0
    return Motion(
        x,
        y,
        wrap_angle(motion.heading + turn_rate * seconds),
        Velocity(speed, turn_rate),
        motion.driven + abs(speed) * seconds,
        is_bumped,
    )


def is_closer(world: World, motion: Motion, x: float, y: float) -> bool:
    """Whether the rover at a point would touch something, and come closer to it than it is now."""
    clearance = world.clearance(x, y)
    return clearance < RADIUS and clearance <= world.clearance(motion.x, motion.y)


def is_blocked_ahead(world: World, motion: Motion, distance: float) -> bool:
    """Whether an obstacle is within this distance ahead."""
    x, y = motion.x + distance * math.cos(motion.heading), motion.y + distance * math.sin(motion.heading)
    return is_closer(world, motion, x, y)


def wrap_angle(angle: float) -> float:
    """Return an angle between -pi and pi."""
    return math.remainder(angle, math.tau)


def _clamp(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))


def _approach(current: float, target: float, gain: float, loss: float) -> float:
    """Return a speed on its way to another one: at most `gain` faster or `loss` slower, stopping at zero."""
    if current * target < 0:
        target = 0.0
    limit = gain if abs(target) > abs(current) else loss
    return target if abs(target - current) <= limit else current + math.copysign(limit, target - current)


CAPACITY = 1.0
"""Ampere-hours."""
CELLS = 3
_IDLE = 1 / (10 * 3600)
"""Share of the capacity that is always drained per second."""
_LIGHTS = 1 / (5 * 3600)
_METRE = 0.002
_RADIAN = 0.0002
_CHARGING = 0.002


@dataclass(frozen=True, slots=True)
class Battery:
    """Charge of the battery, from 0 to 1, and its drain per second (below 0: charging)."""

    level: float = 1.0
    drain: float = _IDLE

    @property
    def is_empty(self) -> bool:
        """Whether the rover can no longer move."""
        return self.level <= 0.0

    @property
    def cell_voltage(self) -> float:
        """Voltage of one of its cells."""
        return 3.3 + 0.9 * self.level

    @property
    def current(self) -> float:
        """Current in amperes, negative while discharging."""
        return -self.drain * CAPACITY * 3600


def drain(battery: Battery, velocity: Velocity, lights: bool, docked: bool, seconds: float) -> Battery:
    """Return the battery after some seconds of this motion."""
    share = _IDLE + _LIGHTS * lights + _METRE * abs(velocity.speed) + _RADIAN * abs(velocity.turn_rate)
    if docked:
        share = 0.0 if battery.level >= 1.0 else -_CHARGING
    level = min(1.0, max(0.0, battery.level - share * seconds))
    return replace(battery, level=level, drain=share if level > 0.0 else 0.0)
