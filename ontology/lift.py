"""Lifting: ROS messages to RDF, compiled once a schema into generated Python functions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from pyoxigraph import Triple

from rosld.adapters.model import Message, MessageSchema

if TYPE_CHECKING:
    from rosld.ontology.document import Envelope

TYPES = "https://w3id.org/rosld/types/"


@dataclass(frozen=True, slots=True)
class LiftSettings:
    """`types`: the namespace of message types; `inline_limit`: bytes above which an array or string is elided."""

    types: str = TYPES
    inline_limit: int = 65536


class Lifter(Protocol):
    """Writes messages of one schema. `document` is the absolute URL, `node` the fragment (`#message`)."""

    schema: MessageSchema
    prefixes: Mapping[str, str]
    context: Mapping[str, object]

    def ntriples(
        self, message: Message, document: str, node: str, *, end: str = " .\n",
        envelope: Envelope | None = None, simulated_time: bool = False,
    ) -> str:
        """N-Triples lines; with `end=" <graph> .\\n"` N-Quads."""
        ...

    def turtle(
        self, message: Message, document: str, node: str, *,
        envelope: Envelope | None = None, simulated_time: bool = False,
    ) -> str:
        """Turtle statements for a document whose `@base` is its URL and whose prefixes include `prefixes`."""
        ...

    def jsonld(
        self, message: Message, document: str, node: str, *,
        envelope: Envelope | None = None, simulated_time: bool = False,
    ) -> str:
        """One JSON-LD node object (text) for a document whose context includes `context` and whose base is its URL."""
        ...

    def json(self, message: Message, document: str) -> bytes:
        """ROS's own JSON of the message (`document` is for the URLs of what is elided)."""
        ...

    def triples(
        self, message: Message, document: str, node: str, *,
        envelope: Envelope | None = None, simulated_time: bool = False,
    ) -> list[Triple]:
        """The same as terms."""
        ...


def lifter(schema: MessageSchema, settings: LiftSettings = LiftSettings()) -> Lifter:
    """The compiled lifter of a schema; compiled once a schema and settings."""
    raise NotImplementedError
