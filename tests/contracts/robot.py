"""What the contract suite must know of a system to try an adapter on it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from rosld.adapters.base import Adapter, ParameterValue


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
class Robot:
    """A running system and how to reach it. None stands for what it has not, and the tests of that do not run.

    `adapter` makes a new adapter, not yet open; `nowhere` one whose source is not there. `readable` is a topic with at
    least five messages a second. `writable` is a topic that another node subscribes to. `answering`, `raising` and
    `hanging` are services. `parameter` is a parameter that is there. `vanish` takes the system away (its name service
    at least) and `come_back` returns it. `trace` tells what the system knows of its visitors.
    """

    name: str
    adapter: Callable[[], Adapter]
    nowhere: Callable[[], Adapter] | None
    readable: str
    writable: Spoken | None = None
    answering: Asked | None = None
    raising: Asked | None = None
    hanging: Asked | None = None
    parameter: tuple[str, ParameterValue] | None = None
    vanish: Callable[[], None] | None = None
    come_back: Callable[[], None] | None = None
    trace: Callable[[], object] | None = None
