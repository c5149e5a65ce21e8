"""The adapter as requests have it: what it is told, the account of the write that is under way is told too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

from rosld.adapters.base import Adapter, Published
from rosld.adapters.model import GoalId, ParameterValue, TypeRef
from rosld.ontology.urls import Space
from rosld.server.receipts.account import accounted_for, under_way
from rosld.server.robot.interlock import Gate
from rosld.server.robot.interlocked_adapter import Gated


class Accounted(Gated):
    """A gated adapter all of whose writes are accounted for."""

    def __init__(self, inner: Adapter, gate: Gate, space: Space) -> None:
        super().__init__(inner, gate)
        self._space = space
        self._topic = lru_cache(maxsize=4096)(space.topic)

    async def publish(
        self, topic: str, type: TypeRef, data: bytes, *, latch: bool = False, deadline: float
    ) -> Published:
        account = under_way.get()
        if account is None:
            return await super().publish(topic, type, data, latch=latch, deadline=deadline)
        account.plans(f"publish a {type.name} on {topic}", self._topic(topic))
        published = await super().publish(topic, type, data, latch=latch, deadline=deadline)
        account.heard(published.matched)
        return published

    async def unadvertise(self, topic: str) -> None:
        accounted_for(f"stop advertising {topic}", self._space.topic(topic))
        await super().unadvertise(topic)

    async def call(self, service: str, type: TypeRef, request: bytes, *, deadline: float) -> bytes:
        accounted_for(f"call {service} ({type.name})", self._space.service(service))
        return await super().call(service, type, request, deadline=deadline)

    async def send_goal(self, action: str, type: TypeRef, goal: bytes, *, deadline: float) -> GoalId:
        accounted_for(f"send a goal to {action} ({type.name})", self._space.action(action))
        return await super().send_goal(action, type, goal, deadline=deadline)

    async def cancel_goal(self, goal: GoalId, *, deadline: float) -> None:
        accounted_for(f"cancel the goal {goal.id} of {goal.action}", self._space.action(goal.action))
        await super().cancel_goal(goal, deadline=deadline)

    async def change_state(self, node: str, transition: str, *, deadline: float) -> None:
        accounted_for(f"have {node} {transition}", self._space.node(node))
        await super().change_state(node, transition, deadline=deadline)

    async def set_parameters(self, values: Mapping[str, ParameterValue], *, deadline: float) -> None:
        for name in values:
            accounted_for(f"set the parameter {name}", self._url_of(name))
        await super().set_parameters(values, deadline=deadline)

    async def delete_parameters(self, names: Sequence[str], *, deadline: float) -> None:
        for name in names:
            accounted_for(f"delete the parameter {name}", self._url_of(name))
        await super().delete_parameters(names, deadline=deadline)

    def _url_of(self, name: str) -> str:
        return self._space.parameter(name)
