"""Simulation of the rover, whose state changes step by step and by commands.

`State` and its changes are pure, so that tests need no clock; a `Simulation` is a state advanced by a clock. A step is
10 ms: the same commands at the same steps lead to the same state.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import NamedTuple
from urllib.parse import parse_qsl

from rosld.adapters.model import GoalStatus
from rosld.adapters.rover.drive import RADIUS, STANDSTILL, Battery, Motion, Velocity, drain, drive, is_blocked_ahead
from rosld.adapters.rover.navigation import (
    Journey,
    JourneyEnd,
    Pose,
    depart,
    drop_passed_corners,
    end_of,
    velocity_towards,
)
from rosld.adapters.rover.settings import DEFAULTS, Settings, Value, settings_of
from rosld.adapters.rover.world import World, small_world

STEP = 0.01
"""Duration of a step in seconds."""
MAX_STEPS = 1000
"""Maximum number of steps at once: after a suspension, the machine must not be busy with the missed ones."""
DOCK = (-4.3, -3.3)
"""Position where the rover is charged."""
_DOCK_REACH = 0.6
_STOP_DISTANCE = 0.2


class Severity(Enum):
    """Severity of a log line (rcl_interfaces/msg/Log)."""

    INFO = 20
    WARN = 30
    ERROR = 40


class LogLine(NamedTuple):
    """A log line: its severity and text."""

    severity: Severity
    text: str


class Answer(NamedTuple):
    """Response of a service: success, and a message."""

    success: bool
    message: str


@dataclass(frozen=True, slots=True)
class Start:
    """Initial state of the rover: charge of its battery, pose, and rate of its clock."""

    battery: float = 1.0
    pose: Pose = field(default_factory=lambda: Pose(0.0, 0.0, 0.0))
    rate: float = 1.0


@dataclass(frozen=True, slots=True)
class State:
    """State of the rover: its motion, command, battery, lights, and the goal that it pursues.

    `ended` are the goals that have ended since they were last taken.
    """

    motion: Motion = field(default_factory=Motion)
    command: Velocity = STANDSTILL
    battery: Battery = field(default_factory=Battery)
    has_lights: bool = False
    is_docked: bool = False
    journey: Journey | None = None
    ended: tuple[JourneyEnd, ...] = ()

    @property
    def is_at_rest(self) -> bool:
        """Whether only the battery changes until the next command."""
        moves = self.command != STANDSTILL and not self.battery.is_empty
        return not moves and self.motion.velocity == STANDSTILL and self.journey is None


def step(state: State, settings: Settings, world: World) -> State:
    """Return the state after a step."""
    motion, command, journey, ended = state.motion, state.command, state.journey, state.ended
    if journey is not None:
        journey = drop_passed_corners(journey, motion)
        command = velocity_towards(journey, motion, settings.limits)
        if (end := end_of(journey, motion, world, state.battery.is_empty)) is not None:
            journey, command, ended = None, STANDSTILL, (*ended, end)
    motion = drive(motion, _limit_command(state, command, settings, world), settings.limits, world, STEP)
    is_docked = state.is_docked and motion.velocity.speed == 0
    battery = drain(state.battery, motion.velocity, state.has_lights, is_docked, STEP)
    return State(motion, command, battery, state.has_lights, is_docked, journey, ended)


def _limit_command(state: State, command: Velocity, settings: Settings, world: World) -> Velocity:
    """Return the velocity that the base follows: none without power, and not towards a near obstacle."""
    if state.battery.is_empty:
        return STANDSTILL
    if settings.stop_before_obstacles and command.speed:
        distance = math.copysign(_STOP_DISTANCE, command.speed)
        if is_blocked_ahead(world, state.motion, distance):
            return command._replace(speed=0.0)
    return command


def rest(state: State, seconds: float) -> State:
    """Return the state after some seconds at rest."""
    battery = drain(state.battery, STANDSTILL, state.has_lights, state.is_docked, seconds)
    return replace(state, battery=battery)


def changes(before: State, after: State, settings: Settings) -> tuple[LogLine, ...]:
    """Return the log lines for the change between two states."""
    lines: list[LogLine] = []
    if after.motion.is_bumped and not before.motion.is_bumped:
        lines.append(LogLine(Severity.WARN, f"an obstacle stops the rover at {_place(after.motion)}"))
    if after.battery.is_empty and not before.battery.is_empty:
        lines.append(LogLine(Severity.ERROR, "the battery is empty: the motors are off"))
    elif after.battery.level < settings.low_battery <= before.battery.level:
        lines.append(LogLine(Severity.WARN, f"the battery is low: {after.battery.level:.0%}"))
    if before.is_docked and not after.is_docked:
        lines.append(LogLine(Severity.INFO, "the rover left the dock"))
    for end in after.ended[len(before.ended) :]:
        severity = Severity.ERROR if end.outcome is GoalStatus.ABORTED else Severity.INFO
        lines.append(LogLine(severity, f"goal {end.outcome.value}: {end.message}"))
    return tuple(lines)


class Simulation:
    """The rover in its world, advanced in time.

    Times are seconds of any monotonic clock; a command takes effect at its time.
    """

    def __init__(self, start: Start, now: float) -> None:
        self.world = small_world()
        self.state = initial_state(start, self.world)
        self.settings = settings_of(DEFAULTS)
        self._rate = start.rate
        self._now = now
        self._lines: list[LogLine] = []

    def advance(self, now: float) -> None:
        """Advance the rover to a time; does nothing for a time in the past."""
        steps = int((now - self._now) * self._rate / STEP)
        if steps <= 0:
            return
        self._now += steps * STEP / self._rate
        if self.state.is_at_rest:
            self._set_state(rest(self.state, steps * STEP))
            return
        state = self.state
        for _ in range(min(steps, MAX_STEPS)):
            state = step(state, self.settings, self.world)
        self._set_state(state)

    def command(self, velocity: Velocity, now: float) -> None:
        """Drive with a velocity from now on. While a goal is pursued, navigation replaces it in the next step."""
        self.advance(now)
        if not all(map(math.isfinite, velocity)):
            self._lines.append(LogLine(Severity.ERROR, f"a velocity of {tuple(velocity)} is not a valid command"))
            return
        self.state = replace(self.state, command=velocity)

    def switch_lights(self, on: bool, now: float) -> Answer:
        self.advance(now)
        self.state = replace(self.state, has_lights=on)
        return Answer(True, f"the lights are {'on' if on else 'off'}")

    def dock(self, now: float) -> Answer:
        """Start charging if the rover is at its dock."""
        self.advance(now)
        motion = self.state.motion
        distance = math.dist((motion.x, motion.y), DOCK)
        if distance > _DOCK_REACH:
            return Answer(False, f"the dock is {distance:.1f} m away: navigate to ({DOCK[0]:g}, {DOCK[1]:g}) first")
        if not self.state.is_at_rest:
            return Answer(False, "the rover is still moving: stop it first")
        self._set_state(replace(self.state, is_docked=True))
        return Answer(True, "charging")

    def navigate(self, id: str, goal: Pose, now: float) -> None:
        """Pursue a goal; a previous goal is aborted."""
        self.advance(now)
        state = self.state
        if state.journey is not None:
            end = JourneyEnd(state.journey.id, GoalStatus.ABORTED, "another goal replaced it")
            self._set_state(replace(state, ended=(*state.ended, end)))
        self.state = replace(self.state, journey=depart(id, goal, self.state.motion, self.world))
        self._lines.append(LogLine(Severity.INFO, f"navigating to ({goal.x:g}, {goal.y:g})"))

    def cancel(self, id: str, now: float) -> bool:
        """Cancel a goal in the next step; return False if it is not being pursued."""
        self.advance(now)
        journey = self.state.journey
        if journey is None or journey.id != id:
            return False
        self.state = replace(self.state, journey=replace(journey, is_canceling=True))
        return True

    def configure(self, values: Mapping[str, Value], now: float) -> None:
        """Set all parameters, which must be valid."""
        self.advance(now)
        self.settings = settings_of(values)

    def take_ended(self) -> tuple[JourneyEnd, ...]:
        """Return the goals that have ended since the last call."""
        ended = self.state.ended
        if ended:
            self.state = replace(self.state, ended=())
        return ended

    def take_log(self) -> tuple[LogLine, ...]:
        """Return the log lines since the last call."""
        lines = tuple(self._lines)
        self._lines.clear()
        return lines

    def _set_state(self, state: State) -> None:
        self._lines += changes(self.state, state, self.settings)
        self.state = state


def initial_state(start: Start, world: World) -> State:
    """Return the initial state. Raises ValueError if something is at the position of the rover."""
    x, y = start.pose.x, start.pose.y
    if not world.contains(x, y) or world.clearance(x, y) < RADIUS:
        raise ValueError(f"the rover cannot start at ({x:g}, {y:g}): something stands within {RADIUS:g} m")
    return State(Motion(x, y, start.pose.heading), battery=Battery(start.battery))


def _place(motion: Motion) -> str:
    return f"({motion.x:.2f}, {motion.y:.2f})"


_OPTIONS = ("battery", "pose", "rate")
_MAX_RATE = 100.0
_EXAMPLE = "rover:?battery=0.21&pose=1,0,1.57&rate=10"


def read_source(text: str) -> Start:
    """Return the initial state in a source. Raises ValueError with a sentence for the user."""
    rest = text.removeprefix("rover").removeprefix(":").removeprefix("//")
    if rest and not rest.startswith("?"):
        raise ValueError(f"{text!r} is not a rover: write rover or {_EXAMPLE}")
    try:
        pairs = parse_qsl(rest[1:], keep_blank_values=True, strict_parsing=bool(rest[1:]))
    except ValueError as error:
        raise ValueError(f"the options of {text!r} cannot be read: write {_EXAMPLE}") from error
    for name, _ in pairs:
        if name not in _OPTIONS:
            raise ValueError(f"{name!r} is not an option of the rover: the options are {', '.join(_OPTIONS)}")
    options = dict(pairs)
    if len(options) < len(pairs):
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
        raise ValueError(f"pose={text!r} is not a pose: use x, y and the heading in radians, such as 1,0,1.57")
    return Pose(*(_number("pose", each, -1000.0, 1000.0) for each in numbers))


def _number(option: str, text: str, least: float, greatest: float) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not least <= number <= greatest:
        raise ValueError(f"{option}={text!r} must be a number from {least:g} to {greatest:g}")
    return number
