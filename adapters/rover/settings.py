"""Parameters of the rover: their declarations, and the settings that follow from their values. No I/O."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TypeAlias

from rosld.adapters.rover.drive import WHEEL_SEPARATION, Limits

NODE = "/rover"
Value: TypeAlias = "bool | int | float | str"


@dataclass(frozen=True, slots=True)
class Declaration:
    """Declaration of a parameter: its initial value, description, and allowed values."""

    default: Value
    description: str
    least: float | None = None
    greatest: float | None = None
    choices: Mapping[str, str] | None = None
    is_read_only: bool = False

    @property
    def constraints(self) -> str:
        """Text about constraints that are not a range."""
        return "" if self.choices is None else f"One of: {', '.join(self.choices)}."


MODES: Mapping[str, str] = MappingProxyType(
    {"eco": "Gentle, for a full room.", "normal": "For every day.", "sport": "As fast as the motors can."}
)
_ACCELERATIONS: Mapping[str, float] = MappingProxyType({"eco": 0.5, "normal": 1.5, "sport": 4.0})

PARAMETERS: Mapping[str, Declaration] = MappingProxyType(
    {
        "max_speed": Declaration(0.5, "The fastest that the rover drives, in m/s.", 0.1, 1.0),
        "max_turn_rate": Declaration(1.5, "The fastest that the rover turns, in rad/s.", 0.2, 2.5),
        "drive_mode": Declaration("normal", "How hard the rover accelerates.", choices=MODES),
        "stop_before_obstacles": Declaration(False, "Whether the base stops by itself before it touches something."),
        "scan_rate": Declaration(10, "Laser scans a second.", 1, 20),
        "camera_rate": Declaration(5, "Images a second.", 1, 15),
        "low_battery": Declaration(0.2, "The level of the battery, from 0 to 1, below which it is low.", 0.05, 0.5),
        "robot_name": Declaration("Rover", "What people call this robot."),
        "wheel_separation": Declaration(
            WHEEL_SEPARATION, "The distance between the wheels, in m, as built.", is_read_only=True
        ),
    }
)
DEFAULTS: Mapping[str, Value] = MappingProxyType({name: each.default for name, each in PARAMETERS.items()})


@dataclass(frozen=True, slots=True)
class Settings:
    """The settings of the rover from its parameters."""

    limits: Limits
    stop_before_obstacles: bool
    scan_rate: int
    camera_rate: int
    low_battery: float


def settings_of(values: Mapping[str, Value]) -> Settings:
    """Return the settings for the values of all parameters, which must be valid."""
    acceleration = _ACCELERATIONS[str(values["drive_mode"])]
    return Settings(
        Limits(float(values["max_speed"]), float(values["max_turn_rate"]), acceleration),
        bool(values["stop_before_obstacles"]),
        int(values["scan_rate"]),
        int(values["camera_rate"]),
        float(values["low_battery"]),
    )


def problem_of(name: str, value: object) -> str | None:
    """Return why a declared parameter cannot have a value, in the node's words, or None."""
    declared = PARAMETERS[name]
    if declared.is_read_only:
        return f"the parameter {name} is read-only"
    expected = type(declared.default)
    if type(value) is not expected:
        return f"{name} is a {_NAMES[expected]}, not a {_NAMES.get(type(value), type(value).__name__)}"
    least, greatest = declared.least, declared.greatest
    if (
        least is not None
        and greatest is not None
        and not (isinstance(value, float | int) and least <= value <= greatest)
    ):
        return f"{name} must be between {least:g} and {greatest:g}, not {value}"
    if declared.choices is not None and value not in declared.choices:
        return f"{name} is one of {', '.join(declared.choices)}, not {value!r}"
    return None


_NAMES: Mapping[type, str] = {bool: "boolean", int: "integer", float: "double", str: "string"}
