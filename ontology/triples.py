"""Constructors of triples for descriptions."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TypeAlias

from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.literals import date_time
from rosld.ontology.vocab import hctl, htv, ldp, rdf, rdfs, ros, td, xsd

Value: TypeAlias = NamedNode | BlankNode | Literal
Statement: TypeAlias = tuple[NamedNode, Value | None]

RDF_SOURCE: tuple[Statement, ...] = ((rdf.type, ldp.Resource), (rdf.type, ldp.RDFSource))
"""Types of every resource of rosld (LDP 4.3)."""
CONTAINER: tuple[Statement, ...] = (*RDF_SOURCE, (rdf.type, ldp.Container), (rdf.type, ldp.BasicContainer))
"""Types of every container (LDP 5.2)."""


def triples_about(subject: NamedNode | BlankNode, *statements: Statement) -> list[Triple]:
    """Return the triples of a subject; statements whose value is None are omitted."""
    return [Triple(subject, predicate, value) for predicate, value in statements if value is not None]


def statements(predicate: NamedNode, values: Iterable[Value]) -> list[Statement]:
    """Return one statement per value."""
    return [(predicate, value) for value in values]


def text(value: str | None) -> Literal | None:
    """Return a string; lone surrogates (from invalid UTF-8) become replacement characters, None stays None."""
    if value is None:
        return None
    try:
        return Literal(value)
    except ValueError:  # a str that is not UTF-8
        return Literal(value.encode("utf-8", "surrogatepass").decode("utf-8", "replace"))


def labelled(predicate: NamedNode, words: str | None) -> tuple[Statement, Statement]:
    """Return a name or a title of a resource that is also its label."""
    value = text(words)
    return (predicate, value), (rdfs.label, value)


def integer(value: int | None) -> Literal | None:
    """Return an xsd:integer; None stays None."""
    return None if value is None else Literal(str(value), datatype=xsd.integer)


def double(value: float) -> Literal:
    """Return an xsd:double with the shortest digits that read back the same."""
    if math.isfinite(value):
        return Literal(repr(float(value)), datatype=xsd.double)
    return Literal("NaN" if math.isnan(value) else "INF" if value > 0 else "-INF", datatype=xsd.double)


def boolean(value: bool) -> Literal:
    """Return an xsd:boolean."""
    return Literal("true" if value else "false", datatype=xsd.boolean)


def date_time_literal(nanoseconds: int | None) -> Literal | None:
    """Return the xsd:dateTime (UTC) of nanoseconds after the epoch; None stays None."""
    return None if nanoseconds is None else Literal(date_time(0, nanoseconds), datatype=xsd.dateTime)


BODIES = ("application/json", "text/turtle", "application/ld+json")
"""Media types of bodies."""
STREAM = ("text/event-stream",)
SSE: Statement = (hctl.forSubProtocol, Literal("sse"))
_ENDINGS: Mapping[str, str] = {"text/turtle": "-turtle", "application/ld+json": "-ld"}


def affordance(subject: NamedNode, name: str, relation: NamedNode, kind: NamedNode, *more: Statement) -> list[Triple]:
    """Return an affordance of the subject: its fragment `name`, linked by `relation`."""
    node = NamedNode(f"{subject.value}#{name}")
    return [Triple(subject, relation, node), *triples_about(node, (rdf.type, kind), (td.name, text(name)), *more)]


def forms(
    affordance: NamedNode,
    name: str,
    method: str,
    operation: NamedNode,
    target: str,
    media_types: Iterable[str] = (),
    *more: Statement,
    template: str | None = None,
) -> list[Triple]:
    """Return a form of an affordance for each media type (WoT TD 1.1, 5.3.4.2).

    `template` is the target with its parameters (RFC 6570).
    """
    triples: list[Triple] = []
    for media_type in tuple(media_types) or (None,):
        form = NamedNode(f"{affordance.value}/{name}{_ENDINGS.get(media_type or '', '')}")
        triples += [
            Triple(affordance, td.hasForm, form),
            *triples_about(
                form,
                (rdf.type, hctl.Form),
                (hctl.hasOperationType, operation),
                (htv.methodName, Literal(method)),
                (hctl.hasTarget, Literal(target, datatype=xsd.anyURI)),
                (ros.uriTemplate, text(template)),
                (hctl.forContentType, text(media_type)),
                *more,
            ),
        ]
    return triples
