"""Table of the RDF syntaxes that rosld writes."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple


class CannotCarry(ValueError):
    """A syntax cannot represent a document; the message names the reason."""


class SyntaxName(NamedTuple):
    """Names of a syntax: its media type, the suffix of its files, and its label."""

    media_type: str
    extension: str
    label: str


class Syntax(Enum):
    """An RDF syntax; `datasets`: whether it has named graphs."""

    TURTLE = SyntaxName("text/turtle", "ttl", "Turtle")
    JSON_LD = SyntaxName("application/ld+json", "jsonld", "JSON-LD")
    N_TRIPLES = SyntaxName("application/n-triples", "nt", "N-Triples")
    RDF_XML = SyntaxName("application/rdf+xml", "rdf", "RDF/XML")
    N3 = SyntaxName("text/n3", "n3", "N3")
    N_QUADS = SyntaxName("application/n-quads", "nq", "N-Quads")
    TRIG = SyntaxName("application/trig", "trig", "TriG")

    @property
    def media_type(self) -> str:
        """Media type, such as `text/turtle`."""
        return self.value.media_type

    @property
    def extension(self) -> str:
        """Extension of files, such as `ttl`, without a dot."""
        return self.value.extension

    @property
    def label(self) -> str:
        """Label, such as `Turtle`."""
        return self.value.label

    @property
    def datasets(self) -> bool:
        """Whether the syntax has named graphs."""
        return self in (Syntax.N_QUADS, Syntax.TRIG)

    @classmethod
    def of(cls, media_type: str) -> Syntax:
        """Return the syntax of a media type (without parameters). Raises ValueError if there is none."""
        for syntax in cls:
            if syntax.media_type == media_type:
                return syntax
        known = ", ".join(syntax.media_type for syntax in cls)
        raise ValueError(f"{media_type!r} is not a supported RDF syntax; choose from {known}")
