"""Bodies of writes: the model they ask for, the triples they state, what they must not change."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterable, Sequence

from pyoxigraph import NamedNode, Triple

from rosld.ontology.body import RdfBody, parse_triples
from rosld.ontology.vocab import ldp
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
from rosld.server.records.describe import MEMBERSHIP, unmanaged
from rosld.server.resources.kept.showing import all_members
from rosld.server.robot import Robot


def asked_model(exchange: Exchange, url: str, *, container: bool) -> Model:
    """The interaction model that a request to `url` asks for; `container`: what is made has a URL of a container."""
    links = parse_links(exchange.header("link") or "")
    return model_asked(links, url, exchange.essence, container_hint=container)


def require_model(exchange: Exchange, model: Model, url: str) -> None:
    """Raise a 409 Problem where a request asks to turn a resource into one of another model (LDP 4.2.3, 5.2.3.4)."""
    links = parse_links(exchange.header("link") or "")
    asked = {link.target for link in links if "type" in link.rel.lower().split() and link.target.startswith(ldp.iri)}
    if not asked <= {kind.value for kind in rdf_types(model)}:
        raise Problem(409, f"This is an ldp:{model.value}, and stays one: make another resource for another model.")


async def statements(exchange: Exchange, url: str) -> list[Triple]:
    """The triples of a body, resolved against `url`. No body at all, of no type, states nothing.

    Raises BodyError, and a 422 Problem for triples about triples, which are not kept.
    """
    data = await exchange.body()
    if not data and exchange.header("content-type") is None:
        return []
    found = parse_triples(data, exchange.media_type, url)
    if any(type(each.object) is Triple or type(each.subject) is Triple for each in found):
        raise Problem(422, "Triples about triples are not kept here.")
    return found


def triples_of(body: RdfBody) -> tuple[Triple, ...]:
    """The triples of a body. Raises a 422 Problem for triples about triples, which are not kept."""
    found = []
    for subject, properties in body.subjects.items():
        for predicate, objects in properties.items():
            for each in objects:
                if isinstance(subject, Triple) or isinstance(each, Triple):
                    raise Problem(422, "Triples about triples are not kept here.")
                found.append(Triple(subject, predicate, each))
    return tuple(found)


def require_membership(membership: Membership, triples: Sequence[Triple], url: str, model: Model) -> None:
    """Raise a 409 Problem where a body would change what a container's membership triples are made of."""
    stated = {each.predicate for each in triples if each.subject == NamedNode(url)} & MEMBERSHIP
    if stated and membership_of(triples, url, model) != membership:
        raise Problem(409, "What membership triples are made of was said when the container was made, and stays so.")


def require_contained(robot: Robot, record: Record, triples: Sequence[Triple]) -> None:
    """Raise a 409 Problem where a body would change what a container contains (LDP 5.2.4.1)."""
    subject = NamedNode(robot.space.base + record.path)
    stated = {each.object for each in triples if each.subject == subject and each.predicate == ldp.contains}
    if not stated:
        return
    members = {NamedNode(robot.space.base + each.path) for each in all_members(robot, record)}
    if stated != members:
        raise Problem(
            409, "What a container contains (ldp:contains) is changed by POST and DELETE, not by its triples."
        )


def require_same_members(before: Iterable[Triple], after: Iterable[Triple], url: str) -> None:
    """Raise a 409 Problem where a patch would change what a container contains (LDP 5.2.4.1)."""
    subject = NamedNode(url)
    told, left = (
        {each.object for each in triples if each.predicate == ldp.contains and each.subject == subject}
        for triples in (before, after)
    )
    if told != left:
        raise Problem(409, "What a container contains (ldp:contains) is changed by POST and DELETE, not by a patch.")


async def received(robot: Robot, exchange: Exchange) -> Blob:
    """The body as a blob, streamed to where it is kept."""
    media_type = exact_media_type(exchange.header("content-type"))
    limit = robot.settings.upload_limit
    return await robot.records.receive(exchange.chunks(limit=limit), media_type, most=limit)


async def one_chunk(data: bytes) -> AsyncIterator[bytes]:
    yield data


def own_triples(robot: Robot, record: Record, triples: Sequence[Triple]) -> list[Triple]:
    """What is the client's to say of a body: all but what the server says of the record itself."""
    own = unmanaged(triples, robot.space.base + record.path)
    if record.membership is None:
        return own
    members = (each.member or robot.space.base + each.path for each in all_members(robot, record))
    servers = set(membership_triples(record.membership, members))
    return [each for each in own if each not in servers]
