"""Documents: the statements of a resource, independent of a syntax.

A `Document` is the RDF of one resource: triples of its description, and ROS messages, each with the compiled `Lifter`
that writes it. Serialization (`ontology/serialize.py`) joins both.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import NamedTuple

from msgspec import Struct
from pyoxigraph import RdfFormat, Triple, parse

from rosld.adapters.model import Message
from rosld.ontology.geometry import (
    geometry_jsonld,
    geometry_ntriples,
    geometry_of,
    geometry_turtle,
    has_place,
)
from rosld.ontology.lift import Lifter
from rosld.ontology.observations import Observer
from rosld.ontology.vocab import geo, sf


class Envelope(NamedTuple):
    """Metadata of a message: time of receipt (ns, wall clock), number, and its publisher's URL."""

    received_ns: int
    sequence: int
    publisher: str | None = None


class LiftedMessage(Struct, frozen=True, eq=False):
    """A message within a document: `node` is its fragment (`#message`); the link to it is among the triples.

    `source` is the URL of its bytes (`?field=`) if that is not the document itself. With `frames`, the URL of the
    robot's frames, a message that states a place has a geometry. With an `observer`, it has observations or actuations.
    """

    node: str
    lifter: Lifter
    message: Message
    envelope: Envelope | None = None
    source: str | None = None
    frames: str | None = None
    observer: Observer | None = None

    @property
    def prefixes(self) -> Mapping[str, str]:
        """The prefixes of its Turtle."""
        may_have_geometry = self.frames is not None and has_place(self.lifter.schema)
        own = _with_geometry(self.lifter) if may_have_geometry else self.lifter.prefixes
        return own if self.observer is None else {**own, **self.observer.prefixes}

    @property
    def context(self) -> Mapping[str, object]:
        """The terms of its JSON-LD."""
        return self.lifter.context if self.observer is None else {**self.lifter.context, **self.observer.context}

    def observations(self, document: Document, notation: str, end: str = " .\n") -> str:
        """Return the observations in a notation, relative to `document`; in JSON-LD node objects, each with a comma."""
        if self.observer is None:
            return ""
        received = None if self.envelope is None else self.envelope.received_ns
        return self.observer.text(
            notation, self.message, document.url, self.node, received, simulated_time=document.simulated_time, end=end
        )

    def text(self, document: Document, notation: str, end: str = " .\n", *, observed: bool = True) -> str:
        """Return the statements in a notation, relative to `document`; in N-Triples with a graph in `end`, N-Quads.

        In JSON-LD this is a node object without observations, otherwise they are included unless `observed` is False.
        """
        text = self.lifter.text(
            notation, self.message, document.url, self.node, end=end, envelope=self.envelope,
            simulated_time=document.simulated_time, source=self.source,
        )  # fmt: skip
        if observed and notation != "jsonld":
            text += self.observations(document, notation, end)
        found = None if self.frames is None else geometry_of(self.lifter.schema, self.message)
        if found is None or self.frames is None:
            return text
        if notation == "jsonld":
            return f"{text[:-1]},{geometry_jsonld(self.node, found, self.frames)}}}"
        if notation == "turtle" and _PREFIXES.keys().isdisjoint(self.lifter.prefixes):  # packages with these names
            return text + geometry_turtle(self.node, found, self.frames)
        return text + geometry_ntriples(document.url + self.node, found, self.frames, end)

    def triples(self, document: Document) -> list[Triple]:
        """Return the triples as terms."""
        # Parsing N-Triples costs less than creating the terms one by one from Python.
        return [quad.triple for quad in parse(self.text(document, "ntriples"), RdfFormat.N_TRIPLES)]


_PREFIXES = {"geo": geo.iri, "sf": sf.iri}


@lru_cache(maxsize=1024)
def _with_geometry(lifter: Lifter) -> Mapping[str, str]:
    return {**_PREFIXES, **lifter.prefixes}


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
