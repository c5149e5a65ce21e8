"""Sources: `rover:?battery=0.21&pose=1,0,1.57&rate=10`, checked."""

from __future__ import annotations

import math
from dataclasses import replace
from urllib.parse import parse_qsl

from rosld.adapters.rover.navigation import Pose
from rosld.adapters.rover.simulation import Start, initial_state
from rosld.adapters.rover.world import small_world

_OPTIONS = ("battery", "pose", "rate")
_MAX_RATE = 100.0
_EXAMPLE = "rover:?battery=0.21&pose=1,0,1.57&rate=10"


def read_source(text: str) -> Start:
    """How the rover of a source begins. Raises ValueError with a sentence for the user."""
    rest = text.removeprefix("rover").removeprefix(":").removeprefix("//")
    if rest and not rest.startswith("?"):
        raise ValueError(f"{text!r} names no rover: write rover or {_EXAMPLE}")
    try:
        given = parse_qsl(rest[1:], keep_blank_values=True, strict_parsing=bool(rest[1:]))
    except ValueError as error:
        raise ValueError(f"the options of {text!r} cannot be read: write {_EXAMPLE}") from error
    for name, _ in given:
        if name not in _OPTIONS:
            raise ValueError(f"{name!r} is no option of the rover: there are {', '.join(_OPTIONS)}")
    options = dict(given)
    if len(options) < len(given):
        raise ValueError(f"an option is given twice in {text!r}")
    start = Start()
    if "battery" in options:
        start = replace(start, battery=_number("battery", options["battery"], 0.0, 1.0))
    if "rate" in options:
        start = replace(start, rate=_number("rate", options["rate"], 0.01, _MAX_RATE))
    if "pose" in options:
        start = replace(start, pose=_pose(options["pose"]))
    initial_state(start, small_world())
    return start


def _pose(text: str) -> Pose:
    numbers = text.split(",")
    if len(numbers) != 3:
        raise ValueError(f"pose={text!r} is no pose: give x, y and the heading in radians, such as 1,0,1.57")
    return Pose(*(_number("pose", each, -1000.0, 1000.0) for each in numbers))


def _number(option: str, text: str, least: float, greatest: float) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not least <= number <= greatest:
        raise ValueError(f"{option}={text!r} must be a number from {least:g} to {greatest:g}")
    return number
