"""The store of goals: events in any order and from any thread."""

from __future__ import annotations

import asyncio
import importlib
import pkgutil
import re
import struct
import threading
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from msgspec import Struct

import rosld.ontology
import rosld.server
from rosld.adapters.model import ActionSchema, Encoding, GoalEvent, GoalId, GoalStatus, Schema, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.urls import locate
from rosld.server.robot.goal_store import Feedback, Goal
from rosld.server.robot.goals import Goals

FLY = TypeLibrary(ros_version=1).find(TypeRef("rosld_aircraft/action/Fly"))
COUNT = TypeLibrary(ros_version=1).learn_action("made_up/action/Count", "int32 to\n---\n---\nint32[] sequence")


class Robot:
    """The part of an adapter that goals of other clients need."""

    class capabilities:  # noqa: N801 - as an adapter has it
        encoding = Encoding.ROS1


@asynccontextmanager
async def keeping(schema: Schema = FLY) -> AsyncIterator[Goals]:
    assert isinstance(schema, ActionSchema)
    robot: Any = Robot()
    goals = Goals(robot, lambda _: schema, limit=100, age=3600.0, idle=60.0)
    goals.start()
    try:
        yield goals
    finally:
        await goals.stop()


async def hear(goals: Goals, id: str, *events: GoalEvent, action: str = "/fly") -> Goal:
    for event in events:
        goals.on_event(GoalId(action, id), event)
        await asyncio.sleep(0)
        await asyncio.sleep(0)
    return goals.of_action(action)[-1]


def status(one: GoalStatus, at: int | None = None, **more: Any) -> GoalEvent:
    return GoalEvent(time.time_ns() if at is None else at, one, **more)


def flown(distance: float) -> bytes:
    return struct.pack("<d", distance)


async def test_no_state_comes_after_one_that_is_final_but_a_lost_goal_may_still_have_ended() -> None:
    async with keeping() as goals:
        goal = await hear(goals, "a", status(GoalStatus.EXECUTING), status(GoalStatus.ACCEPTED))
        assert goal.status is GoalStatus.EXECUTING
        goal = await hear(goals, "a", status(GoalStatus.LOST, words="gone"), status(GoalStatus.EXECUTING))
        assert (goal.status, goal.words) == (GoalStatus.LOST, "gone")
        goal = await hear(goals, "a", status(GoalStatus.SUCCEEDED, words=""), status(GoalStatus.ABORTED))
        assert (goal.status, goal.words) == (GoalStatus.SUCCEEDED, None)


async def test_feedback_faster_than_the_loop_is_told_as_one_and_counted() -> None:
    async with keeping() as goals:
        woken: list[None] = []
        goals.changes.watch(lambda: woken.append(None), lambda about: about == "a")

        def tell() -> None:
            for number in range(1000):
                goals.on_event(GoalId("/fly", "a"), status(GoalStatus.EXECUTING, feedback=flown(number)))

        thread = threading.Thread(target=tell)
        thread.start()
        thread.join()  # the loop is blocked meanwhile
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        goal = goals.find("a")
        assert goal.feedback is not None
        assert getattr(goal.feedback.message, "flown", None) == 999.0
        assert goal.feedback.count == 1000
        assert len(woken) == 1


async def test_feedback_with_arrays_is_told_again_and_again_and_wakes_only_for_what_is_new() -> None:
    async with keeping(COUNT) as goals:
        woken: list[None] = []
        goals.changes.watch(lambda: woken.append(None), lambda about: about == "a")
        for number in range(1, 4):
            sequence = struct.pack(f"<I{number}i", number, *range(number))
            goal = await hear(goals, "a", status(GoalStatus.EXECUTING, words="counting", feedback=sequence))
            assert goal.feedback is not None
            assert goal.feedback.count == number
            assert list(getattr(goal.feedback.message, "sequence")) == list(range(number))  # noqa: B009
        for words in ("counting", "count" + "ing".lower()):  # equal texts, from any client
            await hear(goals, "a", status(GoalStatus.EXECUTING, words=words))
        assert len(woken) == 3


async def test_what_fails_to_be_taken_of_one_goal_keeps_nothing_of_the_others_back(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with keeping() as goals:
        hostile: Any = object()
        goals.on_event(GoalId("/fly", "bad"), status(hostile))
        goals.on_event(GoalId("/fly", "good"), status(GoalStatus.EXECUTING))
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert goals.find("good").status is GoalStatus.EXECUTING
        assert "bad" in caplog.text


@pytest.mark.slow
def test_records_that_hold_messages_are_compared_by_identity() -> None:
    """Messages contain numpy arrays, whose comparison is an array without a truth value."""
    holding = []
    for package in (rosld.server, rosld.ontology):
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if "__main__" not in found.name:
                holding += [each for each in vars(importlib.import_module(found.name)).values() if _holds_message(each)]
    assert {Goal, Feedback} <= set(holding)
    assert [each for each in set(holding) if each.__struct_config__.eq] == []


def _holds_message(found: object) -> bool:
    if not (isinstance(found, type) and issubclass(found, Struct)):
        return False
    return any(re.search(r"\bMessage\b", str(type)) for type in found.__annotations__.values())


async def test_ids_are_safe_in_urls_and_no_two_goals_share_one() -> None:
    async with keeping() as goals:
        hostile = ["/node-1-2.5", "../..", "a" * 100_000, "", "\udcff", "ä?#%2F", "x", "x\0"]
        for action in ("/fly", "/swim"):
            for id in hostile:
                await hear(goals, id, status(GoalStatus.EXECUTING), action=action)
        ids = [goal.id for goal in goals.all()]
        assert len(set(ids)) == len(ids) == 2 * len(hostile)
        assert all(len(id) < 100 and locate(f"/goals/{id}").segments == (id,) for id in ids)
        assert "x" in ids
