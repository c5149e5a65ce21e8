"""Actions of a real ROS 2 system: goals are sent, followed, canceled and lost."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from rosld.adapters.model import (
    ActionSchema,
    Encoding,
    GoalEvent,
    GoalId,
    GoalStatus,
    Kind,
    NotFound,
    Operation,
    Ref,
    Refused,
    ServiceSchema,
    TypeRef,
)
from tests.adapters.ros2.conftest import opened

pytestmark = pytest.mark.slow

FLY = "rosld_aircraft/action/Fly"


async def schema_of(session: Any) -> ActionSchema:
    schema = await session.schema(TypeRef(FLY))
    assert isinstance(schema, ActionSchema)
    return schema


async def send(session: Any, distance: float) -> GoalId:
    """Send the pilot over a distance."""
    await session.until(lambda: Operation.SEND_GOAL in session.adapter.allows(Ref(Kind.ACTION, "/fly")))
    schema = await schema_of(session)
    goal = schema.goal.codec.encode(schema.goal.codec.build(schema.goal.ref.name, {"distance": distance}), Encoding.CDR)
    found: GoalId = await session.adapter.send_goal("/fly", schema.ref, goal, deadline=session.deadline())
    return found


async def events(session: Any, goal: GoalId | None) -> list[GoalEvent]:
    """Return all reported events of a goal (by default the only one), once it has ended."""

    def told() -> list[GoalEvent]:
        return [event for each, event in session.events.goals if goal in (None, each)]

    await session.until(lambda: any(each.status is not None and each.status.is_final for each in told()))
    return told()


async def result(session: Any, told: list[GoalEvent]) -> Any:
    schema = await schema_of(session)
    assert told[-1].result is not None
    return schema.result.codec.decode(told[-1].result, Encoding.CDR)


def statuses(told: list[GoalEvent]) -> list[GoalStatus]:
    return [each.status for each in told if each.status is not None]


async def test_the_topics_of_an_action_are_read_and_its_services_are_known_but_not_called(ros: Any) -> None:
    async with opened(ros) as session:
        action = await session.until(lambda: session.graph.actions.get("/fly"))
        assert (action.type, action.servers, action.unusable) == (TypeRef(FLY), ("/pilot",), None)
        goal = await send(session, 6.0)
        inner = [f"/fly/_action/{name}" for name in ("feedback", "status")]
        for topic in inner:
            known = session.graph.topics[topic]
            assert known.unreadable is None
            assert [each.node for each in known.publishers] == ["/pilot"]
            assert known.subscribers == ()  # rosld's own subscription to the goal is not reported
        feedback, status = [await session.adapter.subscribe(topic) for topic in inner]
        message = await session.decoded((await session.first(feedback))[0])
        assert bytes(message.goal_id.uuid).hex() == goal.id
        assert message.feedback.flown > 0
        told = await session.decoded((await session.first(status))[0])
        assert goal.id in {bytes(each.goal_info.goal_id.uuid).hex() for each in told.status_list}
        await events(session, goal)

        for name, type in (
            ("send_goal", f"{FLY}_SendGoal"),
            ("get_result", f"{FLY}_GetResult"),
            ("cancel_goal", "action_msgs/srv/CancelGoal"),
        ):
            service = session.graph.services[f"/fly/_action/{name}"]
            assert service.type == TypeRef(type)
            assert "the action /fly" in service.uncallable
            assert session.adapter.allows(Ref(Kind.SERVICE, service.name)) == frozenset()
            schema = await session.schema(service.type)
            assert isinstance(schema, ServiceSchema)
            with pytest.raises(Refused, match="the action /fly"):
                await session.call(service.name, schema.ref, b"")


async def test_a_goal_that_is_aborted_or_canceled_has_a_result_too(ros: Any) -> None:
    async with opened(ros) as session:
        told = await events(session, await send(session, 60.0))
        assert (told[0].status, told[0].goal is not None) == (GoalStatus.ACCEPTED, True)
        assert statuses(told)[-1] is GoalStatus.ABORTED
        assert (await result(session, told)).message == "out of fuel"

        goal = await send(session, 40.0)
        await session.until(lambda: any(each == goal and event.feedback for each, event in session.events.goals))
        await session.adapter.cancel_goal(goal, deadline=session.deadline())
        told = await events(session, goal)
        assert statuses(told)[-1] is GoalStatus.CANCELED
        assert (await result(session, told)).message == "called off"
        with pytest.raises((Refused, NotFound)):
            await session.adapter.cancel_goal(goal, deadline=session.deadline())
        with pytest.raises(Refused):
            await session.adapter.send_goal("/fly", TypeRef(FLY), b"", deadline=session.deadline())


async def test_a_goal_that_another_sends_is_followed_to_its_end_and_its_result(ros: Any) -> None:
    async with opened(ros) as session:
        await session.until(lambda: "/fly" in session.graph.actions)
        watch = await session.adapter.follow_goals("/fly", deadline=session.deadline(2))
        session.events.goals.clear()
        await asyncio.to_thread(lambda: ros.node("pilot.py", "send", "8"))
        await session.until(lambda: session.events.goals)
        goal = session.events.goals[-1][0]
        told = await events(session, goal)
        assert not any(each.own for each in told)
        assert any(each.feedback for each in told)
        assert statuses(told)[-1] is GoalStatus.SUCCEEDED
        assert (await result(session, told)).flown == 8.0
        watch.close()
        watch.close()


async def test_a_goal_is_lost_when_its_server_is(lone_ros: Any) -> None:
    pilot = lone_ros.node("pilot.py")
    async with opened(lone_ros) as session:
        goal = await send(session, 40.0)
        pilot.kill()
        told = await events(session, goal)
        assert told[-1].status is GoalStatus.LOST
        assert told[-1].words is not None
