"""A simulated robot with managed nodes, which make transitions as those of ROS 2 do."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from rosld.adapters.model import (
    Endpoint,
    Kind,
    Lifecycle,
    LifecycleState,
    Node,
    NotFound,
    Operation,
    Parameter,
    Qos,
    Ref,
    Refused,
    RosError,
    Sent,
    Service,
    Topic,
    Transition,
    TypeRef,
    freeze,
    without_lifecycle,
)
from tests.server.robots.made_up import MadeUp

STATES = {
    label: LifecycleState(label, id)
    for label, id in {
        "unconfigured": 1, "inactive": 2, "active": 3, "finalized": 4, "configuring": 10, "cleaningup": 11,
        "shuttingdown": 12, "activating": 13, "deactivating": 14,
    }.items()
}  # fmt: skip
TRANSITIONS = {
    "unconfigured": {"configure": (1, "configuring", "inactive"), "shutdown": (5, "shuttingdown", "finalized")},
    "inactive": {
        "cleanup": (2, "cleaningup", "unconfigured"),
        "activate": (3, "activating", "active"),
        "shutdown": (6, "shuttingdown", "finalized"),
    },
    "active": {"deactivate": (4, "deactivating", "inactive"), "shutdown": (7, "shuttingdown", "finalized")},
}
CHATTER = Topic(
    "/chatter",
    (TypeRef("std_msgs/msg/String"),),
    (Endpoint("/camera", qos=Qos("reliable", "volatile", "keep_last", 10)),),
    (Endpoint("/plain", qos=Qos("best_effort", "volatile", "keep_last", 5)),),
)
CHANGE = "lifecycle_msgs/srv/ChangeState"


def standing(node: str, state: str) -> Lifecycle:
    """Return a lifecycle in a state, with the transitions that are legal in it."""
    legal = TRANSITIONS.get(state, {})
    transitions = tuple(Transition(label, id, STATES[goal]) for label, (id, goal, _) in legal.items())
    return Lifecycle(f"{node}/change_state", STATES[state], transitions)


class Managed(MadeUp):
    """`/camera` is a managed node, initially unconfigured, `/plain` one that is not.

    `fails` are the results of transitions that fail: an error, or False if the node refuses. `asked` are the requested
    transitions. Both nodes are on the topic `/chatter`.
    """

    def __init__(self) -> None:
        super().__init__()
        self.fails: dict[str, RosError | bool] = {}
        self.asked: list[str] = []
        self._lifecycle = standing("/camera", "unconfigured")
        self._library.learn_service(
            CHANGE,
            "lifecycle_msgs/Transition transition\n---\nbool success\n"
            + "=" * 80
            + "\nMSG: lifecycle_msgs/Transition\nuint8 id\nstring label",
        )

    def stands(self, lifecycle: str | Lifecycle) -> None:
        """Set the lifecycle of `/camera`, or its state."""
        self._lifecycle = standing("/camera", lifecycle) if isinstance(lifecycle, str) else lifecycle
        self.run(lambda: self._revised(lambda: None))

    async def change_state(self, node: str, transition: str, *, deadline: float) -> None:
        await asyncio.sleep(0)
        if node != "/camera":
            raise without_lifecycle(self.graph.nodes, node)
        state = self._lifecycle.state
        assert state is not None
        legal = TRANSITIONS.get(state.label, {})
        if transition not in legal:
            raise Refused(f"{transition!r} is not a valid transition of {node} now")
        self.asked.append(transition)
        match self.fails.get(transition, True):
            case RosError() as error:
                raise error
            case False:
                raise Refused(f"{node} did not make the transition {transition!r}", sent=Sent.YES)
        self._lifecycle = standing(node, legal[transition][2])
        self._revised(lambda: None)

    def allows(self, ref: Ref) -> frozenset[Operation]:
        if ref == Ref(Kind.NODE, "/camera") and self._lifecycle.transitions:
            return frozenset({Operation.CHANGE_STATE})
        return super().allows(ref)

    def _revised(self, change: Callable[..., object], *arguments: Any) -> None:
        change(*arguments)
        service = f"{self._lifecycle.service}"
        own = "/camera/exposure"
        self.graph = replace(
            self.graph,
            revision=self.graph.revision + 1,
            nodes=freeze({"/camera": Node("/camera", lifecycle=self._lifecycle), "/plain": Node("/plain")}),
            topics=freeze({CHATTER.name: CHATTER}),
            services=freeze({service: Service(service, TypeRef(CHANGE), ("/camera",))}),
            parameters=freeze({own: Parameter(own, "/camera")}),
        )
        if self._sink is not None:
            self._sink.graph_changed(self.graph)


__all__ = ["Managed", "NotFound", "standing"]
