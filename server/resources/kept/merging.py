"""Merging graphs (SPARQL 1.1 Graph Store Protocol 5.5): blank nodes kept apart, bodies of several parts made one."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

from pyoxigraph import BlankNode, Triple

from rosld.ontology.body import parse_triples
from rosld.server.http import media
from rosld.server.http.multipart import MULTIPART, Part, parts
from rosld.server.http.problem import Problem
from rosld.server.http.text import as_utf8
from rosld.server.ldp.exchange import Exchange
from rosld.server.ldp.resource import RDF_BODIES
from rosld.server.records.describe import written

_Term = TypeVar("_Term")
_N_TRIPLES = "application/n-triples"


def apart(triples: Iterable[Triple]) -> list[Triple]:
    """These triples with new blank nodes: graphs that are merged share none (RDF 1.1 Semantics 4.1)."""
    new: dict[BlankNode, BlankNode] = {}
    return [
        Triple(_anew(each.subject, new), each.predicate, _anew(each.object, new)) if _has_blank(each) else each
        for each in triples
    ]


def _has_blank(triple: Triple) -> bool:
    return isinstance(triple.subject, BlankNode) or isinstance(triple.object, BlankNode)


def _anew(term: _Term, new: dict[BlankNode, BlankNode]) -> _Term | BlankNode:
    return new.setdefault(term, BlankNode()) if isinstance(term, BlankNode) else term


async def unite(exchange: Exchange, url: str) -> None:
    """Turn a request whose body is multipart/form-data into one of N-Triples that says what all its parts say.

    The parts are resolved against `url`. Raises BodyError and Problems: 400 for what cannot be cut into parts, 415 for
    parts that are no RDF.
    """
    stated = media.parse(exchange.header("content-type") or "")
    try:
        found = parts(await exchange.octets(), stated.parameter("boundary"))
    except ValueError as error:
        raise Problem(400, f"{MULTIPART}: {error}.") from error
    triples = [triple for number, part in enumerate(found, 1) for triple in _read(part, number, url)]
    exchange.become(exchange.method, _N_TRIPLES, written(triples))


def _read(part: Part, number: int, url: str) -> list[Triple]:
    stated = part.media_type
    if stated is None or stated.essence not in RDF_BODIES:
        raise Problem(
            415,
            f"Part {number} is {stated or 'of unknown type'}; each part says by its Content-Type which RDF it is: "
            f"{', '.join(RDF_BODIES)}.",
        )
    return apart(parse_triples(as_utf8(part.body, stated), stated.essence, url))
