"""Bodies of writes: the model they ask for, the triples they state, what they must not change."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterable, Iterator, Sequence
from functools import cached_property
from typing import overload

from pyoxigraph import NamedNode, RdfFormat, Triple, parse

from rosld.ontology.body import RdfBody, Term, read_ntriples
from rosld.ontology.vocab import ldp
from rosld.server.http.link import Link
from rosld.server.http.link import parse as parse_links
from rosld.server.http.problem import Problem
from rosld.server.ldp.exchange import Exchange
from rosld.server.ldp.files import exact_media_type
from rosld.server.ldp.interaction import (
    membership_of,
    membership_triples,
    model_asked,
    rdf_types,
)
from rosld.server.records import Blob, Membership, Model, Record
from rosld.server.records.describe import MEMBERSHIP, unmanaged, written
from rosld.server.resources.kept.showing import all_members, stand_ins
from rosld.server.robot import Robot


def asked_model(exchange: Exchange, url: str, *, container: bool) -> Model:
    """The interaction model that a request to `url` asks for; `container`: what is made has a URL of a container."""
    return model_asked(_links(exchange), url, exchange.essence, container_hint=container)


def require_model(exchange: Exchange, model: Model, url: str) -> None:
    """Raise a 409 Problem where a request asks to turn a resource into one of another model (LDP 4.2.3, 5.2.3.4)."""
    types = (link.target for link in _links(exchange) if "type" in link.rel.lower().split())
    asked = {target for target in types if target.startswith(ldp.iri)}
    if not asked <= {kind.value for kind in rdf_types(model)}:
        raise Problem(409, f"This is an ldp:{model.value}, and stays one: make another resource for another model.")


def _links(exchange: Exchange) -> Sequence[Link]:
    stated = exchange.header("link")
    return () if stated is None else parse_links(stated)


class Statements(Sequence[Triple]):
    """The triples of a body as N-Triples; parsed when somebody looks at one, as for most bodies nobody does."""

    def __init__(self, ntriples: bytes) -> None:
        self.ntriples = ntriples

    @cached_property
    def _triples(self) -> list[Triple]:
        return [quad.triple for quad in parse(self.ntriples, RdfFormat.N_TRIPLES)]

    @overload
    def __getitem__(self, index: int) -> Triple: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Triple]: ...
    def __getitem__(self, index: int | slice) -> Triple | Sequence[Triple]:
        return self._triples[index]

    def __len__(self) -> int:
        return len(self._triples)

    def __iter__(self) -> Iterator[Triple]:
        return iter(self._triples)


async def statements(exchange: Exchange, url: str) -> Statements:
    """The triples of a body, resolved against `url`. No body at all, of no type, states nothing.

    Raises BodyError, and a 422 Problem for triples about triples, which are not kept.
    """
    data = await exchange.body()
    if not data and exchange.header("content-type") is None:
        return Statements(b"")
    return _kept(Statements(read_ntriples(data, exchange.media_type, url)))


def as_statements(triples: Sequence[Triple]) -> Statements:
    """Triples as a body states them. Raises a 422 Problem for triples about triples, which are not kept."""
    return triples if isinstance(triples, Statements) else _kept(Statements(written(triples)))


def _kept(stated: Statements) -> Statements:
    if b"<<" in stated.ntriples and any(Triple in (type(each.subject), type(each.object)) for each in stated):
        raise Problem(422, "Triples about triples are not kept here.")
    return stated


def triples_of(body: RdfBody) -> list[Triple]:
    """The triples of a body."""
    return [
        Triple(subject, predicate, each)
        for subject, properties in body.subjects.items()
        for predicate, objects in properties.items()
        for each in objects
    ]


def require_membership(membership: Membership, triples: Sequence[Triple], url: str, model: Model) -> None:
    """Raise a 409 Problem where a body would change what a container's membership triples are made of."""
    stated = {each.predicate for each in triples if each.subject == NamedNode(url)} & MEMBERSHIP
    if stated and membership_of(triples, url, model) != membership:
        raise Problem(409, "What membership triples are made of was said when the container was made, and stays so.")


def require_contained(robot: Robot, record: Record, triples: Iterable[Triple]) -> None:
    """Raise a 409 Problem where a body would change what a container contains (LDP 5.2.4.1)."""
    stated = contained(triples, robot.space.base + record.path)
    if stated and stated != {NamedNode(robot.space.base + each.path) for each in all_members(robot, record)}:
        raise Problem(409, f"{_CONTAINED}, not by its triples.")


def require_same_members(before: Iterable[Triple], after: Iterable[Triple], url: str) -> None:
    """Raise a 409 Problem where a patch would change what a container contains (LDP 5.2.4.1)."""
    if contained(before, url) != contained(after, url):
        raise Problem(409, f"{_CONTAINED}, not by a patch.")


_CONTAINED = "What a container contains (ldp:contains) is changed by POST and DELETE"


def contained(triples: Iterable[Triple], url: str) -> set[Term]:
    """What triples say that the container at `url` contains."""
    subject = NamedNode(url)
    return {each.object for each in triples if each.predicate == ldp.contains and each.subject == subject}


async def received(robot: Robot, exchange: Exchange) -> Blob:
    """The body as a blob, streamed to where it is kept, unless it was read already."""
    media_type = exact_media_type(exchange.header("content-type"))
    limit, whole = robot.settings.upload_limit, exchange.received
    chunks = exchange.chunks(limit=limit) if whole is None else one_chunk(whole)
    return await robot.records.receive(chunks, media_type, most=limit)


async def one_chunk(data: bytes) -> AsyncIterator[bytes]:
    yield data


def own_triples(robot: Robot, record: Record, triples: Sequence[Triple]) -> list[Triple]:
    """What is the client's to say of a body: all but what the server says of the record itself."""
    own = unmanaged(triples, robot.space.base + record.path)
    if record.membership is None:
        return own
    servers = set(membership_triples(record.membership, stand_ins(robot, all_members(robot, record))))
    return [each for each in own if each not in servers]
