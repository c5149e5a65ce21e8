"""The drive: it keeps to its limits, stops soon on command, and never collides."""

from __future__ import annotations

import math

from hypothesis import given, settings
from hypothesis import strategies as st

from rosld.adapters.rover.drive import RADIUS, STANDSTILL, Limits, Motion, Velocity, drive, wheel_speeds
from rosld.adapters.rover.world import small_world

WORLD = small_world()
LIMITS = Limits(1.0, 2.5, 4.0)
STEP = 0.01
COMMANDS = st.builds(Velocity, st.floats(-3, 3), st.floats(-5, 5))


def driven(motion: Motion, command: Velocity, seconds: float) -> Motion:
    for _ in range(round(seconds / STEP)):
        motion = drive(motion, command, LIMITS, WORLD, STEP)
    return motion


@settings(max_examples=30)
@given(st.lists(st.tuples(COMMANDS, st.floats(0.1, 2.0)), max_size=12))
def test_it_never_touches_anything_and_keeps_to_its_limits(commands: list[tuple[Velocity, float]]) -> None:
    motion = Motion()
    for command, seconds in commands:
        motion = driven(motion, command, seconds)
        assert WORLD.clearance(motion.x, motion.y) >= RADIUS
        assert abs(motion.velocity.speed) <= LIMITS.speed
        assert abs(motion.velocity.turn_rate) <= LIMITS.turn_rate
        assert abs(motion.heading) <= math.pi


@settings(max_examples=30)
@given(COMMANDS)
def test_it_stands_a_tenth_of_a_second_after_it_is_told_to(command: Velocity) -> None:
    moving = driven(Motion(), command, 1.0)
    assert driven(moving, STANDSTILL, 0.11).velocity == STANDSTILL


def test_it_drives_on_until_something_holds_it_up_and_can_back_off() -> None:
    """The wall beyond the door is 4.9 m ahead of the start."""
    held_up = driven(Motion(), Velocity(1.0), 20.0)
    assert held_up.is_bumped
    assert math.isclose(held_up.x, 4.9 - RADIUS, abs_tol=0.02)
    free = driven(held_up, Velocity(-1.0), 1.0)
    assert not free.is_bumped
    assert free.x < held_up.x - 0.5


def test_the_wheels_turn_against_each_other_on_the_spot() -> None:
    left, right = wheel_speeds(Velocity(0.0, 1.0))
    assert left == -right < 0
