"""Managed nodes of a real ROS 2: their states, their transitions, and those that fail, hang and disappear."""

from __future__ import annotations

from typing import Any

import pytest

from rosld.adapters.model import Kind, Lifecycle, NotFound, Operation, Ref, Refused, Sent, TimedOut
from rosld.adapters.ros2 import message_classes
from tests.adapters.ros2.conftest import opened

pytestmark = pytest.mark.slow


def known(session: Any, node: str) -> Lifecycle | None:
    """Return the lifecycle of a node in the graph."""
    found = session.graph.nodes.get(node)
    return None if found is None else found.lifecycle


def standing(session: Any, node: str) -> tuple[str, list[str]] | None:
    """Return its state and legal transitions."""
    found = known(session, node)
    return None if found is None or found.state is None else (found.state.label, [e.label for e in found.transitions])


async def change(session: Any, node: str, transition: str, seconds: float = 10.0) -> None:
    await session.adapter.change_state(node, transition, deadline=session.deadline(seconds))


async def test_a_managed_node_goes_through_its_life(ros: Any) -> None:
    camera = Ref(Kind.NODE, "/camera")
    async with opened(ros) as session, opened(ros) as other:
        unconfigured = ("unconfigured", ["configure", "shutdown"])
        await session.until(lambda: standing(session, "/camera") == unconfigured)
        await session.until(lambda: "/plain" in session.graph.nodes)
        assert known(session, "/plain") is None
        assert session.adapter.allows(camera) == {Operation.CHANGE_STATE}
        assert session.adapter.allows(Ref(Kind.NODE, "/plain")) == frozenset()
        with pytest.raises(Refused, match="'activate' is not a valid transition of /camera now") as refused:
            await change(session, "/camera", "activate")
        assert refused.value.sent is Sent.NO
        await other.until(lambda: standing(other, "/camera") == unconfigured)
        await change(session, "/camera", "configure")
        assert standing(session, "/camera") == ("inactive", ["cleanup", "activate", "shutdown"])
        told_by_the_node = 3.0  # no client requests it that often
        await other.until(lambda: standing(other, "/camera") == standing(session, "/camera"), timeout=told_by_the_node)
        await change(session, "/camera", "activate")
        assert standing(session, "/camera") == ("active", ["deactivate", "shutdown"])
        await change(session, "/camera", "shutdown")
        assert standing(session, "/camera") == ("finalized", [])
        assert session.adapter.allows(camera) == frozenset()
        with pytest.raises(Refused, match="'configure' is not a valid transition of /camera now"):
            await change(session, "/camera", "configure")
        with pytest.raises(Refused, match="no lifecycle"):
            await change(session, "/plain", "configure")
        with pytest.raises(NotFound, match="/nobody"):
            await change(session, "/nobody", "configure")


async def test_a_transition_that_fails_is_refused_and_one_that_hangs_is_told_as_being_made(ros: Any) -> None:
    async with opened(ros) as session:
        await session.until(lambda: standing(session, "/lidar"))
        with pytest.raises(Refused, match="did not make the transition 'configure'") as failed:
            await change(session, "/lidar", "configure")
        assert failed.value.sent is Sent.YES
        assert standing(session, "/lidar") == ("unconfigured", ["configure", "shutdown"])
        await change(session, "/lidar", "configure")
        with pytest.raises(TimedOut) as late:
            await change(session, "/lidar", "activate", 0.5)
        assert late.value.sent is Sent.MAYBE
        await session.until(lambda: standing(session, "/lidar") == ("activating", []), timeout=5.0)
        await session.trigger("/go")
        await session.until(lambda: standing(session, "/lidar") == ("active", ["deactivate", "shutdown"]))


async def test_a_managed_node_that_answers_nothing_holds_up_nobody_and_one_that_is_killed_is_gone(ros: Any) -> None:
    mute = ros.node("managed.py", "mute")
    async with opened(ros) as session:
        await session.until(lambda: standing(session, "/camera"))
        silent = await session.until(lambda: (found := known(session, "/mute")) is not None and found.unknown and found)
        assert silent.state is None
        assert "did not answer" in silent.unknown
        assert session.adapter.allows(Ref(Kind.NODE, "/mute")) == frozenset()
        with pytest.raises(TimedOut):
            await change(session, "/mute", "configure", 0.5)
        mute.kill()
        await session.until(lambda: "/mute" not in session.graph.nodes)
        with pytest.raises(NotFound):
            await change(session, "/mute", "configure")


async def test_without_lifecycle_msgs_a_managed_node_is_told_with_the_reason(
    ros: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(message_classes, "class_problem", lambda type: f"{type} is not installed")
    async with opened(ros) as session:
        found = await session.until(lambda: known(session, "/camera"))
        assert found.unknown == "lifecycle_msgs/srv/GetState is not installed"
        assert found.state is None
        assert session.adapter.allows(Ref(Kind.NODE, "/camera")) == frozenset()
        await session.until(lambda: "/camera/exposure" in session.graph.parameters)
