"""LOAD: documents of the web that the settings list, fetched before an update is run (SPARQL 1.1 Update, 3.1.4)."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence

from pyoxigraph import NamedNode, Quad, Triple

from rosld.ontology.body import MEDIA_TYPES, parse_triples
from rosld.server.dataset.endpoint_client import Endpoint, StoreError
from rosld.server.http.body import to_utf8
from rosld.server.http.negotiation import parse_media_type
from rosld.server.http.problem import AGENT_SAID, Problem
from rosld.server.sparql.update.operations import ChangeData, Load, Operation


async def load_documents(
    operations: Sequence[Operation], allowed: frozenset[str], *, seconds: float, limit: int
) -> Sequence[Operation]:
    """The operations with what each LOAD found in its place; each may take `seconds` and find `limit` bytes.

    Raises Problems: 403 for a document that is not `allowed`, 422 where no RDF is found, 502 where
    nothing is found; none for LOAD SILENT, which then does nothing.
    """
    return [
        await _load_or_nothing(each, allowed, seconds, limit) if isinstance(each, Load) else each for each in operations
    ]


async def _load_or_nothing(load: Load, allowed: frozenset[str], seconds: float, limit: int) -> ChangeData:
    try:
        return await _insertion(load, allowed, seconds, limit)
    except Problem:
        if load.silent:
            return ChangeData(silent=True)
        raise


async def _insertion(load: Load, allowed: frozenset[str], seconds: float, limit: int) -> ChangeData:
    if load.document not in allowed:
        words = "this server asks only what its settings list (--allow-load), by its whole URL"
        raise Problem(403, f"LOAD of <{load.document}> is refused: {words}. Nothing was done.")
    assert load.into is not None
    triples = await asyncio.to_thread(_read, load.document, seconds, limit)
    return ChangeData(inserts=tuple(_quads(triples, NamedNode(load.into))), silent=load.silent)


def _read(document: str, seconds: float, limit: int) -> Sequence[Triple]:
    endpoint = Endpoint(document, seconds=seconds, limit=limit)
    try:
        answer = endpoint.get(", ".join(MEDIA_TYPES))
        if answer.media_type not in MEDIA_TYPES:
            raise ValueError(f"it is {answer.media_type or 'of no type'}, not one of {MEDIA_TYPES}")
        body = to_utf8(answer.body, parse_media_type(answer.content_type))
        triples = parse_triples(body, answer.media_type, document)
    except StoreError as error:
        raise Problem(502, f"LOAD: {error.sentence}", extra={AGENT_SAID: error.words}) from error
    except (Problem, ValueError) as error:  # a BodyError is one, and may quote what was read
        words = error.detail if isinstance(error, Problem) else f"{error}."
        raise Problem(422, f"LOAD: <{document}> cannot be read.", extra={AGENT_SAID: words}) from error
    finally:
        endpoint.close()
    return triples


def _quads(triples: Sequence[Triple], graph: NamedNode) -> Iterator[Quad]:
    for subject, predicate, value in triples:
        if isinstance(subject, Triple) or isinstance(value, Triple):
            raise Problem(422, f"LOAD: {subject} or {value} is a triple about triples, and these are not kept here.")
        yield Quad(subject, predicate, value, graph)
