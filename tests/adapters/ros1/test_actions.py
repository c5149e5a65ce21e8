"""Actions of a real ROS 1: rospy's action servers and clients, and rosld between them."""

from __future__ import annotations

import asyncio
import signal
import socket
import struct
import xmlrpc.client
from typing import Any

import pytest

from rosld.adapters.model import (
    ActionSchema,
    GoalEvent,
    GoalId,
    GoalStatus,
    Kind,
    Operation,
    Ref,
    Refused,
    TimedOut,
    TypeRef,
    Unreachable,
)
from rosld.adapters.ros1.graph import (
    STATUSES,
    actions_of,
    goal_message,
    read_feedback_or_result,
    read_goal,
    read_statuses,
)
from tests.adapters.ros1.conftest import opened
from tests.adapters.ros1.system import RosSystem
from tests.adapters.session import Session

pytestmark = pytest.mark.slow

SUCCEED, ABORT, REJECT, UNTIL_CANCELED, PENDING, VANISH, SILENT, REJECT_LATE = 1, 2, 3, 4, 5, 6, 7, 8
TEST = TypeRef("actionlib/action/Test")


@pytest.fixture(scope="module")
def acting(ros: RosSystem) -> RosSystem:
    ros.node("action_node.py")
    return ros


async def listed(session: Session, action: str = "/ways") -> None:
    await session.until(lambda: action in session.graph.actions, f"the action {action}")


async def send(session: Session, number: int, action: str = "/ways", seconds: float = 10.0) -> GoalId:
    await listed(session, action)
    return await session.adapter.send_goal(action, TEST, struct.pack("<i", number), deadline=session.deadline(seconds))


def told(session: Session, goal: GoalId | None = None) -> list[GoalEvent]:
    return [event for id, event in session.events.goals if goal in (None, id)]


def states(session: Session, goal: GoalId) -> list[GoalStatus]:
    """Return the reported states of a goal without repetitions, in order."""
    return list(dict.fromkeys(event.status for event in told(session, goal) if event.status is not None))


async def ended(session: Session, goal: GoalId, status: GoalStatus) -> list[GoalEvent]:
    await session.until(lambda: status in states(session, goal), f"{status} of {goal}, told: {told(session, goal)}")
    return told(session, goal)


def run(scenario: Any) -> None:
    asyncio.run(asyncio.wait_for(scenario(), 60))


async def test_an_action_is_five_topics_of_types_that_go_together(acting: RosSystem) -> None:
    async with opened(acting) as session:
        await listed(session)
        action = session.graph.actions["/ways"]
        assert (action.type, action.servers, action.unusable) == (TEST, ("/action_node",), None)
        assert set(session.graph.actions) == {"/ways", "/simple"}
        assert "/ways/status" in session.graph.topics
        assert session.adapter.allows(Ref(Kind.ACTION, "/ways")) == {Operation.SEND_GOAL}
        schema = await session.schema(TEST)
        assert isinstance(schema, ActionSchema)
        assert schema.ref.hash == "991e87a72802262dfbe5d1b3cf6efc9a"  # actionlib.msg.TestAction._md5sum
        assert [half.ref.name for half in (schema.goal, schema.result, schema.feedback)] == [
            "actionlib/action/Test_Goal",
            "actionlib/action/Test_Result",
            "actionlib/action/Test_Feedback",
        ]


async def test_a_goal_ends_in_every_way_with_the_servers_words(acting: RosSystem) -> None:
    async with opened(acting) as session:
        for number, words in ((REJECT, "the arm is folded"), (REJECT_LATE, "thought twice")):
            with pytest.raises(Refused) as refusal:
                await send(session, number)
            assert refusal.value.words == words
        assert not any(event.own for event in told(session))
        goal = await send(session, ABORT)
        events = await ended(session, goal, GoalStatus.ABORTED)
        assert any(event.result is not None for event in events)
        assert "the gripper is jammed" in [event.words for event in told(session, goal)]
        for number, before in ((UNTIL_CANCELED, GoalStatus.EXECUTING), (PENDING, GoalStatus.ACCEPTED)):
            goal = await send(session, number)
            await session.until(lambda id=goal, wanted=before: wanted in states(session, id), f"{before}")
            await session.adapter.cancel_goal(goal, deadline=session.deadline())
            await ended(session, goal, GoalStatus.CANCELED)
            assert states(session, goal)[-3:] == [before, GoalStatus.CANCELING, GoalStatus.CANCELED]


async def test_a_goal_whose_server_vanishes_is_lost(lone_ros: RosSystem) -> None:
    lone_ros.node("action_node.py")
    async with opened(lone_ros) as session:
        goal = await send(session, VANISH)
        events = await ended(session, goal, GoalStatus.LOST)
        assert events[-1].words == "the server of /ways is gone"
        with pytest.raises((Unreachable, TimedOut)):
            await send(session, SUCCEED, seconds=2.0)


async def test_goals_of_others_are_seen_while_somebody_looks_and_without_a_trace(acting: RosSystem) -> None:
    async with opened(acting) as session:
        await listed(session, "/simple")
        unseen = acting.node("action_client.py", "/simple", "1")
        unseen.line("done")
        unseen.stop()
        assert not session.events.goals, "nobody looks"
        before = acting.master.getSystemState("/test")
        watch = await session.adapter.follow_goals("/simple", deadline=session.deadline())
        assert acting.master.getSystemState("/test") == before
        other = acting.node("action_client.py", "/simple", "8")
        await session.until(lambda: GoalStatus.EXECUTING in [event.status for event in told(session)], "a goal")
        [goal] = {id for id, event in session.events.goals if event.status is GoalStatus.EXECUTING}
        assert not any(event.own for event in told(session))
        await session.until(lambda: any(event.feedback for event in told(session, goal)), "feedback")
        await session.adapter.cancel_goal(goal, deadline=session.deadline())
        await ended(session, goal, GoalStatus.CANCELED)
        other.line("done 2")
        watch.close()
        watch.close()


def test_actions_without_a_server_are_listed_as_unusable_and_other_topics_are_none() -> None:
    five = {
        "/a/goal": "p/XActionGoal",
        "/a/cancel": "actionlib_msgs/GoalID",
        "/a/status": "actionlib_msgs/GoalStatusArray",
        "/a/feedback": "p/XActionFeedback",
        "/a/result": "p/XActionResult",
    }
    clients = {"/a/goal": ("/c",), "/a/cancel": ("/c",)}
    readers = dict.fromkeys(five, ("/c",))
    [action] = actions_of(clients, readers, five).values()
    assert (action.name, action.type, action.clients) == ("/a", TypeRef("p/action/X"), ("/c",))
    assert action.unusable is not None
    for topic in five:
        assert not actions_of(clients, readers, {**five, topic: "p/Other"})
        gone = {each: nodes for each, nodes in readers.items() if each != topic}
        assert topic == "/a/goal" or topic in clients or not actions_of(clients, gone, five)


def test_every_state_of_actionlib_has_one_of_the_model() -> None:
    assert set(STATUSES) == set(range(10))
    assert set(STATUSES.values()) == set(GoalStatus)


def test_a_truncated_message_is_refused() -> None:
    whole = goal_message("/me-1", 1_500_000_000_000_000_001, b"goal")
    assert read_goal(whole) == ("/me-1", b"goal")
    for read in (read_goal, read_statuses, read_feedback_or_result):
        for end in range(20):
            with pytest.raises(ValueError, match="the message ends at byte"):
                read(whole[:end])
    with pytest.raises(ValueError, match="cannot be in 20 bytes"):
        read_statuses(bytes(16) + b"\xff\xff\xff\xff")
    with pytest.raises(ValueError, match="exceeds the limit"):
        read_statuses(bytes(5_000_000))


def subscribe(uri: str, node: str, topic: str, type: str) -> socket.socket:
    """Return a connection to a node's topic under a given name, after the response header."""
    publisher: Any = xmlrpc.client.ServerProxy(uri)
    _, host, port = publisher.requestTopic(node, topic, [["TCPROS"]])[2]
    fields = (f"callerid={node}", f"topic={topic}", f"type={type}", "md5sum=*")
    body = b"".join(struct.pack("<I", len(each)) + each.encode() for each in fields)
    connection = socket.create_connection((host, port), timeout=10)
    connection.sendall(struct.pack("<I", len(body)) + body)
    (size,) = struct.unpack("<I", connection.recv(4, socket.MSG_WAITALL))
    connection.recv(size, socket.MSG_WAITALL)
    return connection


@pytest.mark.parametrize("name", ["/recorder", "/action_node"])
def test_a_goal_reaches_its_server_whoever_else_reads_and_whichever_connection_it_drops(
    lone_ros: RosSystem, name: str
) -> None:
    """rospy connects twice when it is notified twice, and drops the first connection with its unread data."""
    server = lone_ros.node("action_node.py").process

    async def scenario() -> None:
        async with opened(lone_ros) as session:
            await listed(session)
            watch = await session.adapter.follow_goals("/ways", deadline=session.deadline())
            await session.until(rosld_reads_results, "a connection to the results")
            server.send_signal(signal.SIGSTOP)
            try:
                sending = asyncio.ensure_future(send(session, SUCCEED, seconds=30))
                await session.until(lambda: lone_ros.publishers("/ways/goal"), "the topic of goals")
                (own,) = lone_ros.publishers("/ways/goal")
                uri = lone_ros.master.lookupNode("/test", own)[2]
                other = await asyncio.to_thread(subscribe, uri, name, "/ways/goal", "actionlib/TestActionGoal")
                if name == "/action_node":
                    assert await asyncio.to_thread(other.recv, 4, socket.MSG_WAITALL)
                    other.close()
            finally:
                server.send_signal(signal.SIGCONT)
            await ended(session, await sending, GoalStatus.SUCCEEDED)
            other.close()
            watch.close()

    def rosld_reads_results() -> bool:
        """Whether the server has the connections over which rosld receives the state of its goals."""
        uri = lone_ros.master.lookupNode("/test", "/action_node")[2]
        node: Any = xmlrpc.client.ServerProxy(uri)
        busy = node.getBusInfo("/test")[2]
        return {each[4] for each in busy if each[2] == "o"} >= {"/ways/result", "/ways/feedback", "/ways/status"}

    run(scenario)
