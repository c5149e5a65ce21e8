"""The battery: what driving takes from it and the dock gives back. Pure."""

from __future__ import annotations

from dataclasses import dataclass, replace

from rosld.adapters.rover.drive import Velocity

CAPACITY = 1.0
"""Ampere hours."""
CELLS = 3
_IDLE = 1 / (10 * 3600)
"""The share of the capacity that a second takes in any case."""
_LIGHTS = 1 / (5 * 3600)
_METRE = 0.002
_RADIAN = 0.0002
_CHARGING = 0.002


@dataclass(frozen=True, slots=True)
class Battery:
    """How full the battery is, from 0 to 1, and how much of it a second takes (below 0: gives)."""

    level: float = 1.0
    drain: float = _IDLE

    @property
    def is_empty(self) -> bool:
        """Whether the rover cannot move any more."""
        return self.level <= 0.0

    @property
    def cell_voltage(self) -> float:
        """The voltage of one of its cells."""
        return 3.3 + 0.9 * self.level

    @property
    def current(self) -> float:
        """Amperes, below 0 while it discharges."""
        return -self.drain * CAPACITY * 3600


def drain(battery: Battery, velocity: Velocity, lights: bool, docked: bool, seconds: float) -> Battery:
    """The battery a while later, during which the rover moved so."""
    share = _IDLE + _LIGHTS * lights + _METRE * abs(velocity.speed) + _RADIAN * abs(velocity.turn_rate)
    if docked:
        share = 0.0 if battery.level >= 1.0 else -_CHARGING
    level = min(1.0, max(0.0, battery.level - share * seconds))
    return replace(battery, level=level, drain=share if level > 0.0 else 0.0)
