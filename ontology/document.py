"""Documents: the statements of a resource, independent of a syntax.

A `Document` is the RDF of one resource: triples of its description, and ROS messages, each with the compiled `Lifter`
that writes it. Serialization (`ontology/serialize.py`) joins both.
"""

from __future__ import annotations

from typing import NamedTuple

from msgspec import Struct
from pyoxigraph import Triple

from rosld.adapters.model import Message
from rosld.ontology.lift import Lifter


class Envelope(NamedTuple):
    """Metadata of a message: time of receipt (ns, wall clock), number, and its publisher's URL."""

    received_ns: int
    sequence: int
    publisher: str | None = None


class LiftedMessage(Struct, frozen=True, eq=False):
    """A message within a document: `node` is its fragment (`#message`); the link to it is among the triples.

    `source` is the URL of its bytes (`?field=`) if that is not the document itself.
    """

    node: str
    lifter: Lifter
    message: Message
    envelope: Envelope | None = None
    source: str | None = None

    def turtle(self, document: Document) -> str:
        """Return Turtle statements, relative to `document`."""
        return self.lifter.turtle(
            self.message, document.url, self.node, envelope=self.envelope, simulated_time=document.simulated_time,
            source=self.source,
        )  # fmt: skip

    def jsonld(self, document: Document) -> str:
        """Return a JSON-LD node object (text), relative to `document`."""
        return self.lifter.jsonld(
            self.message, document.url, self.node, envelope=self.envelope, simulated_time=document.simulated_time,
            source=self.source,
        )  # fmt: skip

    def ntriples(self, document: Document, end: str = " .\n") -> str:
        """Return N-Triples lines; with a graph in `end`, N-Quads."""
        return self.lifter.ntriples(
            self.message, document.url, self.node, end=end, envelope=self.envelope,
            simulated_time=document.simulated_time, source=self.source,
        )  # fmt: skip

    def triples(self, document: Document) -> list[Triple]:
        """Return the triples as terms."""
        return self.lifter.triples(
            self.message, document.url, self.node, envelope=self.envelope, simulated_time=document.simulated_time,
            source=self.source,
        )  # fmt: skip


class Document(Struct, frozen=True):
    """The RDF of the resource at `url`: its description, and its messages.

    `simulated_time`: stamps are no wall-clock times, so no xsd:dateTime is derived from them. `parts` are complete
    documents within it: syntaxes with named graphs put each into the graph of its URL.
    """

    url: str
    triples: tuple[Triple, ...]
    messages: tuple[LiftedMessage, ...] = ()
    simulated_time: bool = False
    parts: tuple[Document, ...] = ()

    def all_triples(self) -> list[Triple]:
        """Return the description, the messages and the parts, as terms."""
        own = [*self.triples, *(triple for message in self.messages for triple in message.triples(self))]
        return own + [triple for part in self.parts for triple in part.all_triples()]

    def joined(self) -> Document:
        """Return the document with its messages and parts as triples of one graph."""
        return Document(self.url, tuple(self.all_triples())) if self.parts else self
