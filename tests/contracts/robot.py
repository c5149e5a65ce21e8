"""Description of a system on which the contract suite tests an adapter."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from rosld.adapters.base import Adapter
from rosld.adapters.model.parameter import ParameterValue


@dataclass(frozen=True)
class Spoken:
    """A topic, the name of its type, and the fields of a message that can be published on it."""

    topic: str
    type: str
    values: Mapping[str, object]


@dataclass(frozen=True)
class Asked:
    """A service, the fields of a request, and the expected result: some fields of the response, or the node's words."""

    service: str
    type: str
    values: Mapping[str, object]
    response: Mapping[str, object] | None = None
    words: str | None = None


@dataclass(frozen=True)
class Acted:
    """An action, and the fields of two goals: one that soon succeeds, with feedback, and one that lasts until canceled.

    `before` are services to call so that goals are accepted.
    """

    action: str
    type: str
    quick: Mapping[str, object]
    lasting: Mapping[str, object]
    before: tuple[Asked, ...] = ()


@dataclass(frozen=True)
class Robot:
    """A running system and how to reach it. Attributes are None if it lacks them, and their tests do not run.

    `adapter` creates a new adapter, not yet open; `nowhere` one whose source does not exist. `readable` is a topic with
    at least five messages per second. `writable` is a topic that another node subscribes to. `answering`, `raising` and
    `hanging` are services. `acting` is an action, `rejecting` one and the fields of a goal that is rejected; `other`
    lets another node send the lasting goal, and returns a function that ends it. `parameter` is an existing parameter.
    `owner` is a node that has its own parameters and accepts any; `guarded` is a parameter of a node, a value that this
    node refuses, and its words. `vanish` removes the system (at least its name service) and `come_back` restores it.
    `trace` returns what the system knows about its clients.
    """

    name: str
    adapter: Callable[[], Adapter]
    nowhere: Callable[[], Adapter] | None
    readable: str
    writable: Spoken | None = None
    answering: Asked | None = None
    raising: Asked | None = None
    hanging: Asked | None = None
    acting: Acted | None = None
    rejecting: tuple[str, str, Mapping[str, object]] | None = None
    other: Callable[[], Callable[[], None]] | None = None
    parameter: tuple[str, ParameterValue] | None = None
    owner: str | None = None
    guarded: tuple[str, ParameterValue, str] | None = None
    vanish: Callable[[], None] | None = None
    come_back: Callable[[], None] | None = None
    trace: Callable[[], object] | None = None
