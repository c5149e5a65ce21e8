"""Bodies of writes: the requested model, stated and server-managed triples (LDP 4.2.4.3), and merges of graphs."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterable, Sequence
from functools import partial

from pyoxigraph import Literal, NamedNode, Triple

from rosld.ontology.body import parse_triples, read_ntriples
from rosld.ontology.literals import date_time_nanoseconds
from rosld.ontology.vocab import dcterms, ldp, rdf
from rosld.server.http.body import MULTIPART, Part, split_parts, to_utf8
from rosld.server.http.fields import Link, parse_links
from rosld.server.http.negotiation import parse_media_type
from rosld.server.http.problem import Problem
from rosld.server.resources.ldp.base import Documents
from rosld.server.resources.ldp.representation import all_members, member_uris
from rosld.server.resources.ldp.statements import (
    CONTAINMENT,
    MAX_PATCHED,
    NO_STATEMENTS,
    Statements,
    client_triples,
    contained_members,
    is_small,
    parse_body_statements,
    parse_statements,
    rename_blank_nodes,
    statements_of,
)
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import RDF_BODIES
from rosld.server.rest.interaction import membership_declaration, membership_triples, requested_model
from rosld.server.rest.responses import exact_media_type
from rosld.server.runtime.offload import WorkerPool
from rosld.server.storage.record import Blob, Membership, Model, Record, rdf_types
from rosld.server.storage.record_documents import (
    MAX_TIME_BYTES,
    MEMBERSHIP,
    TIMES,
    client_times,
    is_managed,
    managed_triples,
    parse_ntriples,
    to_ntriples,
    unpack_triples,
    unpacked_size,
)


def model_of_request(exchange: Exchange, url: str, *, container: bool) -> Model:
    """Return the interaction model that a request to `url` specifies; raises like `requested_model`.

    `container`: the URL of the new resource ends in a slash.
    """
    return requested_model(_links(exchange), url, exchange.essence, container_hint=container)


def require_model(exchange: Exchange, model: Model) -> None:
    """Raise a 409 Problem if a request would change the interaction model of a resource (LDP 4.2.3, 5.2.3.4)."""
    links = _links(exchange)
    if not links:
        return
    types = (link.target for link in links if "type" in link.rel.lower().split())
    models = {target for target in types if target.startswith(ldp.iri)}
    if not models <= {kind.value for kind in rdf_types(model)}:
        raise Problem(
            409, f"This is an ldp:{model.value} and cannot change: create another resource for another model."
        )


def _links(exchange: Exchange) -> Sequence[Link]:
    stated = exchange.header("link")
    return () if stated is None else parse_links(stated)


async def read_statements(workers: WorkerPool, exchange: Exchange, url: str, subject: str) -> Statements:
    """Return the triples of a body about `subject`, resolved against `url`; none without body and Content-Type.

    Raises BodyError, and a 422 Problem for triples about triples.
    """
    data = await exchange.body()
    if not data and exchange.header("content-type") is None:
        return NO_STATEMENTS
    if is_small(data):
        return statements_of(read_ntriples(data, exchange.media_type, url))
    return await workers.run(partial(parse_body_statements, data, exchange.media_type, url, subject))


async def as_statements(triples: Sequence[Triple], subject: str) -> Statements:
    """Return triples as the statements of a body about `subject`. Raises a 422 Problem for triples about triples."""
    if isinstance(triples, Statements):
        return triples
    if len(triples) <= MAX_PATCHED:
        return statements_of([*triples])
    return await asyncio.to_thread(lambda: parse_statements(to_ntriples(triples), subject))


def require_small(triples: Sequence[Triple]) -> None:
    """Raise a 413 Problem for more than a few thousand triples."""
    if isinstance(triples, Statements) and triples.is_large:
        raise Problem(413, "This is too large to store: at most a few thousand triples.")


def require_same_containment(documents: Documents, record: Record, triples: Iterable[Triple]) -> None:
    """Raise a 409 Problem if a body would change what a container contains (LDP 5.2.4.1)."""
    stated = contained_members(triples, documents.space.base + record.path)
    if stated and stated != {
        NamedNode(documents.space.base + each.path) for each in all_members(documents.records, record)
    }:
        raise Problem(409, f"{CONTAINMENT}, not by its triples.")


async def receive_blob(documents: Documents, exchange: Exchange) -> Blob:
    """Stream the body into a blob.

    Raises Problems (415 for a malformed Content-Type, or like `read_chunks`), ValueError if too large, StorageError.
    """
    media_type = exact_media_type(exchange.header("content-type"))
    limit, whole = documents.settings.upload_limit, exchange.consumed_body
    chunks = exchange.chunks(limit=limit) if whole is None else single_chunk(whole)
    return await documents.records.receive(chunks, media_type, limit=limit)


async def single_chunk(data: bytes) -> AsyncIterator[bytes]:
    """Yield a body that was read already as a single chunk."""
    yield data


async def client_statements(documents: Documents, record: Record, triples: Statements, times: bytes) -> bytes:
    """Return the client's triples of a body in packed form, without server-managed ones, preceded by `times`.

    `times` are the N-Triples of the times stated by the first writer.
    """
    subject, servers = documents.space.base + record.path, frozenset[Triple]()
    if record.membership is not None:
        servers = frozenset(
            membership_triples(record.membership, member_uris(documents.space, all_members(documents.records, record)))
        )
    work = partial(client_triples, triples, subject, record.model, servers, times)
    return await documents.workers.run(work) if triples.is_large else work()


_N_TRIPLES = "application/n-triples"
_MAX_UNITED = 4 * 1024 * 1024
"""Maximum size in bytes of the N-Triples of a graph created from several parts."""


async def merged_statements(workers: WorkerPool, exchange: Exchange, url: str, subject: str) -> Statements:
    """Return the statements about `subject` in all parts of a multipart/form-data body.

    The parts are resolved against `url`. Raises BodyError and Problems: 400 for a malformed body, 415 for a part that
    is not RDF.
    """
    data, stated = await exchange.raw_body(), parse_media_type(exchange.header("content-type") or "")
    work = partial(_unite, data, stated.parameter("boundary"), url, subject)
    return work() if is_small(data) else await workers.run(work)


async def merge_parts(workers: WorkerPool, exchange: Exchange, url: str) -> None:
    """Replace the multipart/form-data body of a request with the merged N-Triples of its parts.

    Raises like `merged_statements`, and a 413 Problem if the result is too large.
    """
    found = await merged_statements(workers, exchange, url, url)
    if unpacked_size(found.packed) > _MAX_UNITED:
        raise Problem(413, f"The parts exceed {_MAX_UNITED} bytes of N-Triples: PUT one body instead.")
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
            f"Part {number} is {stated or 'of unknown type'}; each part needs an RDF Content-Type: "
            f"{', '.join(RDF_BODIES)}.",
        )
    return rename_blank_nodes(parse_triples(to_utf8(part.body, stated), stated.essence, url))


_MILLISECOND = 1_000_000
"""Nanoseconds in a millisecond, the precision of times in many clients (such as JavaScript)."""


def managed_triples_in(triples: Sequence[Triple], url: str, model: Model) -> list[Triple]:
    """Return the server-managed triples in a body about the resource at `url`."""
    if not triples:
        return []
    subject = NamedNode(url)
    return [each for each in triples if each.subject == subject and is_managed(each.predicate, each.object, model)]


# New resources


def initial_times(managed: Sequence[Triple]) -> bytes:
    """Return the times of creation and modification that the first writer states, as N-Triples.

    Raises a 409 Problem for several values, or for a value that is not a short literal.
    """
    found: list[Triple] = []
    for predicate in TIMES:
        stated = list(dict.fromkeys(each for each in managed if each.predicate == predicate))
        if len(stated) > 1 or not all(isinstance(each.object, Literal) for each in stated):
            raise Problem(409, f"{predicate.value} of a resource must be one literal, such as a date.")
        if stated and len(str(stated[0].object).encode()) > MAX_TIME_BYTES - 100:
            raise Problem(409, f"{predicate.value} is longer than any date: shorten it.")
        found += stated
    return to_ntriples(found)


def require_classes(managed: Sequence[Triple], model: Model) -> None:
    """Raise a 409 Problem if a body states another interaction model than that of the new resource."""
    for each in managed:
        if each.predicate == rdf.type and each.object not in rdf_types(model):
            requested = each.object.value if isinstance(each.object, NamedNode) else each.object
            words = f"{rdf.type.value} {requested} conflicts with ldp:{model.value}. Request another"
            raise Problem(409, f'{words} interaction model by a Link header with rel="type" (LDP 5.2.3.4).')


# Existing resources


def require_unchanged(managed: Sequence[Triple], record: Record, url: str) -> None:
    """Raise a 409 Problem that names the property if a body changes a server-managed triple of a resource.

    Any modification time since the creation is accepted, so that clients can restore an earlier state. Members and
    membership are checked separately.
    """
    present, first = managed_triples(record, url), parse_ntriples(b"".join(client_times(record, url)))
    for each in managed:
        if each.predicate == ldp.contains or each.predicate in MEMBERSHIP or each in present or each in first:
            continue
        now = [one.object for one in present if one.predicate == each.predicate]
        if each.predicate in TIMES and _is_a_time_of(each, now, record):
            continue
        raise _refusal(each, now)


def require_membership(membership: Membership, managed: Sequence[Triple], url: str) -> None:
    """Raise a 409 Problem that names the property if a body changes the configuration of membership triples."""
    present = membership_declaration(membership, url)
    for each in managed:
        is_default = each.predicate == ldp.insertedContentRelation and membership.content is None
        if each.predicate not in MEMBERSHIP or each in present or (is_default and each.object == ldp.MemberSubject):
            continue
        raise _refusal(each, [one.object for one in present if one.predicate == each.predicate])


def _is_a_time_of(stated: Triple, now: Sequence[object], record: Record) -> bool:
    at = _milliseconds(stated.object)
    if at is None:
        return False
    if stated.predicate == dcterms.modified and record.created_ns // _MILLISECOND <= at:
        return at <= record.modified_ns // _MILLISECOND
    return at in map(_milliseconds, now)


def _milliseconds(value: object) -> int | None:
    at = date_time_nanoseconds(value.value) if isinstance(value, Literal) else None
    return None if at is None else at // _MILLISECOND


def _refusal(stated: Triple, now: Sequence[object]) -> Problem:
    is_so = f"is {' and '.join(map(str, now))} here" if now else "is absent here"
    return Problem(409, f"{stated.predicate.value} {is_so}and managed by the server: omit {stated.object}.")
