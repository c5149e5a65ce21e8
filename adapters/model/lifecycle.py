"""Lifecycles of managed nodes (ROS 2's design article "Managed nodes"): the state of one, and what may become of it."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass

from rosld.adapters.model.errors import NotFound, Refused

_UNDERWAY = range(10, 16)


@dataclass(frozen=True, slots=True)
class LifecycleState:
    """A state as its node calls it ("inactive"), with its number in lifecycle_msgs/msg/State."""

    label: str
    id: int

    @property
    def is_underway(self) -> bool:
        """Whether a transition is being made: what then follows is for the node alone to say."""
        return self.id in _UNDERWAY


@dataclass(frozen=True, slots=True)
class Transition:
    """A transition as its node calls it ("activate"), its number there, and the state that it leads to."""

    label: str
    id: int
    goal: LifecycleState


@dataclass(frozen=True, slots=True)
class Lifecycle:
    """How a managed node stands: its state and the transitions that are legal now, as it told them itself.

    `service` is the service that carries them out. `unknown` says in words why its state cannot be told now; a state
    beside it is the last one told. Without a state nothing was told ever.
    """

    service: str
    state: LifecycleState | None = None
    transitions: tuple[Transition, ...] = ()
    unknown: str | None = None


def without_lifecycle(nodes: Container[str], node: str) -> NotFound | Refused:
    """What `Adapter.change_state` raises for a node that is not managed, or not there."""
    if node not in nodes:
        return NotFound(f"there is no node {node}")
    return Refused(f"{node} is no managed node: it has no lifecycle")
