"""Creation of resources: the record, and the containers on the way to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from pyoxigraph import Triple

from rosld.server.http.problem import Problem
from rosld.server.resources.ldp.base import StoredResource
from rosld.server.resources.ldp.bodies import as_statements, read_statements
from rosld.server.resources.ldp.documents import Documents
from rosld.server.resources.ldp.managed_triples import initial_times, managed_triples_in, require_classes
from rosld.server.resources.ldp.statements import (
    NO_STATEMENTS,
    Statements,
    client_triples,
    contained_members,
    member_uri,
)
from rosld.server.resources.ldp.transaction import write_together
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.interaction import parse_membership
from rosld.server.runtime.dry_run import expect_status
from rosld.server.storage.record import Blob, Model, Put, Record, container_of
from rosld.server.storage.sqlite import Records


async def create_record(
    kept: StoredResource, model: Model, exchange: Exchange, blob: Blob | None, *, unused: bool = False
) -> Record:
    """Make the resource that `kept` stands for, and the containers on the way to it that are missing.

    `blob` is the body of a non-RDF source. Raises Conflict where something was made at its path meanwhile, or with
    `unused` was ever there.
    """
    documents, path = kept.documents, kept.path
    expect_status(201)
    if model is Model.NON_RDF_SOURCE:
        require_free(documents, path)
        put = Put(path, model, blob=blob, expected=0, unused=unused)
        writes = [*_ways_to(documents.records, path), await _as_member(documents, put, NO_STATEMENTS, kept.url)]
    else:
        stated = await read_statements(documents.workers, exchange, kept.url, kept.url)
        writes = await creation_writes(documents, path, model, stated, unused=unused)
    record = (await write_together(documents, writes))[-1]
    assert record is not None
    return record


async def creation_writes(
    documents: Documents, path: str, model: Model, triples: Sequence[Triple], *, unused: bool = False
) -> list[Put]:
    """The writes that make an RDF source or a container that says these triples, the last being its own.

    With `unused` that one is done only where nothing was ever at its path.
    Raises 409 Problems for a name that is taken, and for containment that is stated; 422 for triples about triples.
    """
    require_free(documents, path)
    url = documents.space.base + path
    stated = await as_statements(triples, url)
    managed = managed_triples_in(stated.managed, url, model)
    if managed:
        if contained_members(managed, url):
            raise Problem(409, "A new container contains nothing: leave ldp:contains away, and POST its members to it.")
        require_classes(managed, model)
        work = partial(client_triples, stated, url, model, frozenset[Triple](), initial_times(managed))
        kept = await documents.workers.run(work) if stated.is_large else work()
    else:
        kept = stated.packed
    put = Put(path, model, kept, membership=parse_membership(managed, url, model), expected=0, unused=unused)
    return [*_ways_to(documents.records, path), await _as_member(documents, put, stated, url)]


async def _as_member(documents: Documents, put: Put, stated: Statements, url: str) -> Put:
    """With what stands for it in the membership triples of its container (LDP 5.5.1.2)."""
    container = documents.records.get(container_of(put.path))
    if container is None or container.membership is None:
        return put
    work = partial(member_uri, container.membership, stated, url)
    member = await documents.workers.run(work) if stated.is_large else work()
    return replace(put, member=member)


def _ways_to(records: Records, path: str) -> list[Put]:
    """The containers to be made first."""
    found: list[Put] = []
    above = container_of(path)
    while above and records.get(above) is None:
        found.insert(0, Put(above, Model.BASIC_CONTAINER, only_if_absent=True))
        above = container_of(above)
    return found


def require_free(documents: Documents, path: str) -> None:
    """Raise a 409 Problem where the same name is a container already, or is none: a name means one thing."""
    other = path[:-1] if path.endswith("/") else path + "/"
    if documents.records.get(other) is not None:
        raise Problem(409, f"There is {documents.space.base}{other} already: choose another name.")
