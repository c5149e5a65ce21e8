"""`ros:asOf` and `ros:previous`: recorded messages by their places in time. Pure.

Where there is no such message the result is rdf:nil, which has no statements: an unbound variable would match every
message.
"""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

from pyoxigraph import NamedNode

from rosld.ontology.vocab import rdf, ros
from rosld.server.dataset.base import Term
from rosld.server.sparql.math_functions import time_ns

AS_OF, PREVIOUS = ros.asOf.value, ros.previous.value
FUNCTIONS = frozenset({AS_OF, PREVIOUS})
_NODE = "#message"


class MessageTimes(NamedTuple):
    """Messages of a topic in one recording, by time: their times in ns, and their numbers, which follow `messages`.

    `topic` and `messages` are URLs.
    """

    topic: str
    messages: str
    times: array[int]
    numbers: array[int]

    def iri(self, place: int) -> NamedNode:
        """Return the IRI of a message."""
        return NamedNode(f"{self.messages}{self.numbers[place]}{_NODE}")


class MessageOrder:
    """Order in time of the messages that a query reads."""

    def __init__(self, topics: Iterable[MessageTimes]) -> None:
        self._by_topic: dict[str, list[MessageTimes]] = {}
        for each in topics:
            self._by_topic.setdefault(each.topic, []).append(each)
        self._places: dict[str, dict[int, tuple[MessageTimes, int]]] = {}

    def functions(self) -> Mapping[str, Callable[..., Term]]:
        """Return the functions by IRI. They raise ValueError for invalid arguments."""
        return {AS_OF: self.as_of, PREVIOUS: self.previous}

    def as_of(self, topic: Term, time: Term) -> Term:
        """`ros:asOf(?topic, ?time)`: the newest message of a topic at a time."""
        at = time_ns(time)
        if not isinstance(topic, NamedNode):
            raise ValueError("not a topic")
        places = ((each, bisect_right(each.times, at) - 1) for each in self._by_topic.get(topic.value, ()))
        found = max(((each.times[place], each, place) for each, place in places if place >= 0), default=None)
        return rdf.nil if found is None else found[1].iri(found[2])

    def previous(self, message: Term) -> Term:
        """`ros:previous(?message)`: the message before a message, of the same topic and recording."""
        if not isinstance(message, NamedNode):
            raise ValueError("not a message")
        messages, _, number = message.value.removesuffix(_NODE).rpartition("/")
        if not self._places:
            self._find_places()
        found = self._places.get(f"{messages}/", {}).get(int(number)) if number.isdigit() else None
        return found[0].iri(found[1] - 1) if found is not None and found[1] > 0 else rdf.nil

    def _find_places(self) -> None:
        for each in (one for of_topic in self._by_topic.values() for one in of_topic):
            places = self._places.setdefault(each.messages, {})
            places.update((number, (each, place)) for place, number in enumerate(each.numbers))
