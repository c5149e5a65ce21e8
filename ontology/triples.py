"""Constructors of triples for descriptions."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TypeAlias

from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.literals import date_time
from rosld.ontology.vocab import ldp, rdf, xsd

Value: TypeAlias = NamedNode | BlankNode | Literal
Statement: TypeAlias = tuple[NamedNode, Value | None]

RDF_SOURCE: tuple[Statement, ...] = ((rdf.type, ldp.Resource), (rdf.type, ldp.RDFSource))
"""What every resource of rosld is (LDP 4.3)."""
CONTAINER: tuple[Statement, ...] = (*RDF_SOURCE, (rdf.type, ldp.Container), (rdf.type, ldp.BasicContainer))
"""What every container is (LDP 5.2)."""


def triples_about(subject: NamedNode | BlankNode, *statements: Statement) -> list[Triple]:
    """The triples of a subject; a statement whose value is None is none."""
    return [Triple(subject, predicate, value) for predicate, value in statements if value is not None]


def statements(predicate: NamedNode, values: Iterable[Value]) -> list[Statement]:
    """A statement a value."""
    return [(predicate, value) for value in values]


def text(value: str | None) -> Literal | None:
    """A string; lone surrogates (bytes that were no UTF-8) become replacement characters, None stays None."""
    if value is None:
        return None
    try:
        return Literal(value)
    except ValueError:  # a str that is not UTF-8
        return Literal(value.encode("utf-8", "surrogatepass").decode("utf-8", "replace"))


def integer(value: int | None) -> Literal | None:
    """An xsd:integer; None stays None."""
    return None if value is None else Literal(str(value), datatype=xsd.integer)


def double(value: float) -> Literal:
    """An xsd:double with the shortest digits that read back the same."""
    if math.isfinite(value):
        return Literal(repr(float(value)), datatype=xsd.double)
    return Literal("NaN" if math.isnan(value) else "INF" if value > 0 else "-INF", datatype=xsd.double)


def boolean(value: bool) -> Literal:
    """An xsd:boolean."""
    return Literal("true" if value else "false", datatype=xsd.boolean)


def date_time_literal(nanoseconds: int | None) -> Literal | None:
    """The xsd:dateTime (UTC) so many nanoseconds after the epoch; None stays None."""
    return None if nanoseconds is None else Literal(date_time(0, nanoseconds), datatype=xsd.dateTime)
