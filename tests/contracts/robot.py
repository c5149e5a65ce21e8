"""What the contract suite must know of a system to try an adapter on it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from rosld.adapters.base import Adapter
from rosld.adapters.model.parameter import ParameterValue


@dataclass(frozen=True)
class Spoken:
    """A topic, the name of its type, and the fields of a message that can be published there."""

    topic: str
    type: str
    values: Mapping[str, object]


@dataclass(frozen=True)
class Asked:
    """A service, the fields of a request, and what comes of it: some fields of the response, or the node's words."""

    service: str
    type: str
    values: Mapping[str, object]
    response: Mapping[str, object] | None = None
    words: str | None = None


@dataclass(frozen=True)
class Acted:
    """An action, and the fields of two goals: one that soon succeeds, with feedback, and one that lasts till canceled.

    `before` are services to be called so that goals are taken.
    """

    action: str
    type: str
    quick: Mapping[str, object]
    lasting: Mapping[str, object]
    before: tuple[Asked, ...] = ()


@dataclass(frozen=True)
class Robot:
    """A running system and how to reach it. None stands for what it has not, and the tests of that do not run.

    `adapter` makes a new adapter, not yet open; `nowhere` one whose source is not there. `readable` is a topic with at
    least five messages a second. `writable` is a topic that another node subscribes to. `answering`, `raising` and
    `hanging` are services. `acting` is an action, `rejecting` one and the fields of a goal that is rejected; `other`
    has another node send the lasting goal, and returns what ends it. `parameter` is a parameter that is there. `owner`
    is a node whose parameters are its own and which takes any; `guarded` is a parameter of a node, a value that this
    node refuses, and its words. `vanish` takes the system away (its name service at least) and `come_back` returns it.
    `trace` tells what the system knows of its visitors.
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
