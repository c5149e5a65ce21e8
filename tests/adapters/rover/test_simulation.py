"""The simulation: equal commands lead to equal states, however often it is observed."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rosld.adapters.model import GoalStatus
from rosld.adapters.rover.drive import STANDSTILL, Velocity
from rosld.adapters.rover.navigation import Declined, Pose, check_goal, heading_of
from rosld.adapters.rover.settings import DEFAULTS
from rosld.adapters.rover.simulation import DOCK, MAX_STEPS, STEP, Severity, Simulation, Start

AHEAD = Velocity(0.5, 0.3)


def begun(**start: object) -> Simulation:
    return Simulation(Start(**start), 0.0)


def texts(simulation: Simulation, severity: Severity) -> str:
    return "; ".join(line.text for line in simulation.take_log() if line.severity is severity)


def ended(simulation: Simulation, now: float, patience: float = 60.0) -> tuple[GoalStatus, str]:
    """Return how the current goal ends, observed as often as a clock would."""
    for turn in range(round(patience / 0.05)):
        simulation.advance(now + 0.05 * turn)
        if found := simulation.take_ended():
            return found[0].outcome, found[0].message
    raise AssertionError("the goal never ended")


@settings(max_examples=30)
@given(st.lists(st.floats(0.001, 0.5), max_size=30))
def test_looking_often_changes_nothing(pauses: list[float]) -> None:
    once, often = begun(), begun()
    for each in (once, often):
        each.command(AHEAD, 0.0)
    now = 0.0
    for pause in pauses:
        now += pause
        often.advance(now)
    once.advance(now)
    for each in (once, often):  # until both have made all steps
        each.advance(now + 2 * STEP)
    behind = abs(once.state.motion.driven - often.state.motion.driven)
    assert behind <= 0.5 * STEP + 1e-9


def test_time_passes_faster_at_a_higher_rate() -> None:
    slow, fast = begun(), begun(rate=10.0)
    slow.command(AHEAD, 0.0)
    fast.command(AHEAD, 0.0)
    slow.advance(10.0)
    fast.advance(1.0)
    assert math.isclose(slow.state.motion.driven, fast.state.motion.driven, abs_tol=0.5 * STEP + 1e-9)


def test_a_machine_that_was_asleep_catches_up_with_seconds_and_not_with_hours() -> None:
    simulation = begun()
    simulation.command(Velocity(0.2, 0.8), 0.0)
    simulation.advance(36_000.0)
    assert simulation.state.motion.driven <= 0.2 * MAX_STEPS * STEP
    simulation.advance(36_001.0)
    assert simulation.state.motion.velocity == Velocity(0.2, 0.8)


def test_a_velocity_that_is_no_number_is_told_in_the_log_and_not_driven() -> None:
    simulation = begun()
    simulation.command(AHEAD, 0.0)
    simulation.command(Velocity(math.nan, 0.0), 0.1)
    simulation.command(Velocity(0.0, math.inf), 0.2)
    assert simulation.state.command == AHEAD
    assert "not a valid command" in texts(simulation, Severity.ERROR)


@pytest.mark.slow
def test_the_battery_is_drained_by_driving_and_the_motors_are_off_once_it_is_empty() -> None:
    simulation = begun(battery=0.205)
    simulation.command(AHEAD, 0.0)
    simulation.advance(10.0)
    assert simulation.state.battery.level < 0.2
    assert "battery is low" in texts(simulation, Severity.WARN)
    for now in range(11, 400):
        simulation.advance(float(now))
    assert simulation.state.battery.is_empty
    assert simulation.state.motion.velocity == STANDSTILL
    assert "battery is empty" in texts(simulation, Severity.ERROR)


def test_it_charges_at_the_dock_until_it_drives_away() -> None:
    simulation = begun(battery=0.5)
    assert not simulation.dock(0.0).success
    there = begun(battery=0.5, pose=Pose(*DOCK, 0.0))
    assert there.dock(0.0).success
    there.advance(10.0)
    assert there.state.battery.level > 0.5
    assert there.state.battery.current > 0
    there.command(AHEAD, 10.0)
    there.advance(11.0)
    assert not there.state.is_docked
    assert there.state.battery.current < 0


def test_a_goal_is_reached_with_its_heading() -> None:
    simulation = begun()
    simulation.navigate("a", Pose(3.0, -1.5, -1.0), 0.0)
    assert ended(simulation, 0.0) == (GoalStatus.SUCCEEDED, "arrived")
    motion = simulation.state.motion
    assert math.dist((motion.x, motion.y), (3.0, -1.5)) < 0.1
    assert math.isclose(motion.heading, -1.0, abs_tol=0.05)
    simulation.advance(70.0)
    assert simulation.state.motion.velocity == STANDSTILL


def test_a_goal_fails_in_words() -> None:
    for x, y, words in ((30.0, 0.0, "outside the map"), (0.0, 2.6, "an obstacle stands"), (3.5, 3.0, "not on the map")):
        simulation = begun()
        simulation.navigate("a", Pose(x, y, 0.0), 0.0)
        outcome, message = ended(simulation, 0.0)
        assert outcome is GoalStatus.ABORTED
        assert words in message


def test_a_goal_ends_when_the_battery_does_when_it_is_canceled_and_when_another_comes() -> None:
    weak = begun(battery=0.001)
    weak.navigate("a", Pose(4.4, -3.4, 0.0), 0.0)
    assert ended(weak, 0.0) == (GoalStatus.ABORTED, "the battery is empty")
    simulation = begun()
    simulation.navigate("a", Pose(4.4, -3.4, 0.0), 0.0)
    assert not simulation.cancel("b", 0.5)
    assert simulation.cancel("a", 0.5)
    assert ended(simulation, 0.6) == (GoalStatus.CANCELED, "canceled")
    simulation.navigate("c", Pose(4.4, -3.4, 0.0), 1.0)
    simulation.navigate("d", Pose(0.0, 0.0, 0.0), 1.5)
    assert ended(simulation, 1.5) == (GoalStatus.ABORTED, "another goal replaced it")


def test_a_command_does_not_end_a_goal() -> None:
    simulation = begun()
    simulation.navigate("a", Pose(4.4, 0.0, 0.0), 0.0)
    simulation.command(STANDSTILL, 1.0)
    simulation.advance(2.0)
    assert simulation.state.motion.velocity.speed > 0


def test_what_is_no_goal_is_declined() -> None:
    for wrong in ((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, math.nan), (1.0, 1.0, 1.0, 1.0)):
        with pytest.raises(Declined, match="unit quaternion"):
            heading_of(*wrong)
    with pytest.raises(Declined, match="moon"):
        check_goal("moon", 0.0, 0.0, 0.0)
    with pytest.raises(Declined, match="not a valid position"):
        check_goal("map", math.nan, 0.0, 0.0)
    assert math.isclose(heading_of(0.0, 0.0, math.sin(0.5), math.cos(0.5)), 1.0)


def test_it_stops_by_itself_where_it_is_set_to() -> None:
    simulation = begun()
    simulation.configure({**DEFAULTS, "stop_before_obstacles": True}, 0.0)
    simulation.command(Velocity(1.0), 0.0)
    for now in range(1, 30):
        simulation.advance(float(now))
    assert not simulation.state.motion.is_bumped
    assert 4.3 < simulation.state.motion.x < 4.6
