"""Merging graphs (SPARQL 1.1 Graph Store Protocol 5.5): blank nodes kept apart, bodies of several parts made one."""

from __future__ import annotations

from functools import partial

from pyoxigraph import Triple

from rosld.ontology.body import parse_triples
from rosld.server.http.body import MULTIPART, Part, split_parts, to_utf8
from rosld.server.http.negotiation import parse_media_type
from rosld.server.http.problem import Problem
from rosld.server.resources.ldp.statements import Statements, is_small, parse_statements, rename_blank_nodes
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import RDF_BODIES
from rosld.server.runtime.offload import WorkerPool
from rosld.server.storage.record_documents import to_ntriples, unpack_triples, unpacked_size

_N_TRIPLES = "application/n-triples"
_MAX_UNITED = 4 * 1024 * 1024
"""Bytes of N-Triples that several parts may make a new graph of."""


async def merged_statements(workers: WorkerPool, exchange: Exchange, url: str, subject: str) -> Statements:
    """The statements about `subject` of a request whose body is multipart/form-data: what all its parts say.

    The parts are resolved against `url`. Raises BodyError and Problems: 400 for what cannot be cut into parts, 415 for
    parts that are no RDF.
    """
    data, stated = await exchange.raw_body(), parse_media_type(exchange.header("content-type") or "")
    work = partial(_unite, data, stated.parameter("boundary"), url, subject)
    return work() if is_small(data) else await workers.run(work)


async def merge_parts(workers: WorkerPool, exchange: Exchange, url: str) -> None:
    """Turn a request whose body is multipart/form-data into one of N-Triples that says what all its parts say.

    Raises what `merged_statements` raises, and a 413 Problem where that is too large.
    """
    found = await merged_statements(workers, exchange, url, url)
    if unpacked_size(found.packed) > _MAX_UNITED:
        raise Problem(413, f"The parts say more than {_MAX_UNITED} bytes of N-Triples: PUT one body instead.")
    exchange.override(exchange.method, _N_TRIPLES, unpack_triples(found.packed))


def _unite(data: bytes, boundary: str | None, url: str, subject: str) -> Statements:
    try:
        found = split_parts(data, boundary)
    except ValueError as error:
        raise Problem(400, f"{MULTIPART}: {error}.") from error
    triples = [triple for number, part in enumerate(found, 1) for triple in _read(part, number, url)]
    return parse_statements(to_ntriples(triples), subject)


def _read(part: Part, number: int, url: str) -> list[Triple]:
    stated = part.media_type
    if stated is None or stated.essence not in RDF_BODIES:
        raise Problem(
            415,
            f"Part {number} is {stated or 'of unknown type'}; each part says by its Content-Type which RDF it is: "
            f"{', '.join(RDF_BODIES)}.",
        )
    return rename_blank_nodes(parse_triples(to_utf8(part.body, stated), stated.essence, url))
