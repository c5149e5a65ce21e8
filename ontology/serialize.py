"""Documents to bytes in every RDF syntax: the description by the writers here, the messages by their lifters."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from msgspec.structs import replace

from rosld.ontology.document import Document
from rosld.ontology.jsonld import jsonld
from rosld.ontology.rdfxml import rdfxml
from rosld.ontology.syntax import CannotCarry, Syntax
from rosld.ontology.turtle import trig, turtle

__all__ = ["CannotCarry", "Syntax", "serialize", "serialize_named"]


def serialize(document: Document, syntax: Syntax | str) -> bytes:
    """Return the document in a syntax (or the syntax of a media type), in UTF-8. All syntaxes have the same triples.

    A document is one graph (LDP 4.3.1), so N-Quads and TriG have its triples in the default graph, but those of its
    parts in graphs of their own. Raises CannotCarry if the syntax cannot represent the document, ValueError for a media
    type that is no RDF syntax.
    """
    syntax = syntax if isinstance(syntax, Syntax) else Syntax.of(syntax)
    if document.parts and syntax in _NAMED_WRITERS:
        named = (_NAMED_WRITERS[syntax](part) for part in document.parts)
        return b"".join([_WRITERS[syntax](replace(document, parts=())), *named])
    return _WRITERS[syntax](document.joined())


def serialize_named(document: Document, syntax: Syntax) -> bytes:
    """Return the document as a part of a dataset: N-Quads and TriG have its triples in the graph named by its URL.

    Other syntaxes are as in `serialize`; raises as that does.
    """
    return _NAMED_WRITERS.get(syntax, _WRITERS[syntax])(document)


def serialize_without_observations(document: Document) -> bytes:
    """Return the document in N-Triples, without the observations of its messages."""
    return _lines(document, " .\n", observed=False)


def _lines(document: Document, end: str, *, observed: bool = True) -> bytes:
    # pyoxigraph prints a triple as in N-Triples, without the full stop.
    lines = [f"{triple}{end}" for triple in dict.fromkeys(document.triples)]
    return "".join(
        [*lines, *(message.text(document, "ntriples", end, observed=observed) for message in document.messages)]
    ).encode()


_WRITERS: Mapping[Syntax, Callable[[Document], bytes]] = {
    Syntax.TURTLE: lambda document: turtle(document).encode(),
    Syntax.JSON_LD: jsonld,
    Syntax.N_TRIPLES: lambda document: _lines(document, " .\n"),
    Syntax.RDF_XML: lambda document: rdfxml(document.all_triples(), document.url).encode(),
    Syntax.N3: lambda document: turtle(document).encode(),
    Syntax.N_QUADS: lambda document: _lines(document, " .\n"),
    Syntax.TRIG: lambda document: turtle(document).encode(),
}
_NAMED_WRITERS: Mapping[Syntax, Callable[[Document], bytes]] = {
    Syntax.N_QUADS: lambda document: _lines(document, f" <{document.url}> .\n"),
    Syntax.TRIG: lambda document: trig(document).encode(),
}
