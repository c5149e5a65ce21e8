"""Making resources: a record with what leads to it."""

from __future__ import annotations

from collections.abc import Sequence

from pyoxigraph import NamedNode, Quad, Triple

from rosld.ontology.body import indexed
from rosld.ontology.vocab import ldp
from rosld.server.http.problem import Problem
from rosld.server.ldp.exchange import Exchange
from rosld.server.ldp.interaction import (
    member_of,
    membership_of,
)
from rosld.server.records import Membership, Model, Put, Record
from rosld.server.records.describe import unmanaged, written
from rosld.server.resources.kept.base import Kept
from rosld.server.resources.kept.bodies import received, statements
from rosld.server.robot import Robot


async def made(kept: Kept, model: Model, exchange: Exchange) -> Record:
    """Make the resource that `kept` stands for, and the containers on the way to it that are missing."""
    robot, path, url = kept.robot, kept.path, kept.url
    require_free(robot, path)
    if model is Model.NON_RDF_SOURCE:
        put = Put(path, model, blob=await received(robot, exchange), expected=0)
        triples: Sequence[Triple] = ()
    else:
        triples = await statements(exchange, url)
        if any(each.subject == NamedNode(url) and each.predicate == ldp.contains for each in triples):
            raise Problem(409, "A new container contains nothing: leave ldp:contains away, and POST its members to it.")
        own = written(unmanaged(triples, url))
        put = Put(path, model, own, membership=membership_asked(model, triples, url), expected=0)
    records = await kept.do(*_ways_to(robot, path), _as_member(robot, put, triples, url))
    record = records[-1]
    assert record is not None
    return record


def _as_member(robot: Robot, put: Put, triples: Sequence[Triple], url: str) -> Put:
    """With what stands for it in the membership triples of its container (LDP 5.5.1.2)."""
    container = robot.records.get(container_of(put.path))
    if container is None or container.membership is None:
        return put
    body = indexed((Quad(each.subject, each.predicate, each.object) for each in triples), url)
    member = member_of(container.membership, body, url)
    return Put(put.path, put.model, put.triples, put.blob, put.membership, member, put.expected)


def _ways_to(robot: Robot, path: str) -> list[Put]:
    """The containers to be made first."""
    found: list[Put] = []
    above = container_of(path)
    while above != "/" and robot.records.get(above) is None:
        found.insert(0, Put(above, Model.BASIC_CONTAINER, expected=0))
        above = container_of(above)
    return found


def require_free(robot: Robot, path: str) -> None:
    """Raise a 409 Problem where the same name is a container already, or is none: a name means one thing."""
    other = path[:-1] if path.endswith("/") else path + "/"
    if robot.records.get(other) is not None:
        raise Problem(409, f"There is {robot.space.base}{other} already: choose another name.")


def container_of(path: str) -> str:
    """The path of the container that a path lies in."""
    return path.rstrip("/").rpartition("/")[0] + "/"


def membership_asked(model: Model, triples: Sequence[Triple], url: str) -> Membership | None:
    """The membership of a Direct or Indirect container, as its body says."""
    return membership_of(triples, url, model) if model in (Model.DIRECT_CONTAINER, Model.INDIRECT_CONTAINER) else None
