"""Making resources: a record with what leads to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pyoxigraph import Triple

from rosld.ontology.body import body_of
from rosld.server.http.problem import Problem
from rosld.server.ldp.exchange import Exchange
from rosld.server.ldp.interaction import (
    member_of,
    membership_of,
)
from rosld.server.records import Blob, Model, Put, Record
from rosld.server.records.describe import may_be_managed, unmanaged, written
from rosld.server.records.paths import container_of
from rosld.server.resources.kept.base import Kept
from rosld.server.resources.kept.bodies import as_statements, contained, statements
from rosld.server.resources.kept.together import kept_together
from rosld.server.robot import Robot


async def made(kept: Kept, model: Model, exchange: Exchange, blob: Blob | None, *, unused: bool = False) -> Record:
    """Make the resource that `kept` stands for, and the containers on the way to it that are missing.

    `blob` is the body of a non-RDF source. Raises Conflict where something was made at its path meanwhile, or with
    `unused` was ever there.
    """
    robot, path = kept.robot, kept.path
    if model is Model.NON_RDF_SOURCE:
        require_free(robot, path)
        put = Put(path, model, blob=blob, expected=0)
        writes = [*_ways_to(robot, path), _as_member(robot, put, (), kept.url)]
    else:
        writes = making(robot, path, model, await statements(exchange, kept.url))
    record = (await kept_together(robot, [*writes[:-1], replace(writes[-1], unused=unused)]))[-1]
    assert record is not None
    return record


def making(robot: Robot, path: str, model: Model, triples: Sequence[Triple]) -> list[Put]:
    """The writes that make an RDF source or a container that says these triples, the last being its own.

    Raises 409 Problems for a name that is taken, and for containment that is stated; 422 for triples about triples.
    """
    require_free(robot, path)
    url, stated = robot.space.base + path, as_statements(triples)
    own = stated.ntriples
    if may_be_managed(own):
        if contained(stated, url):
            raise Problem(409, "A new container contains nothing: leave ldp:contains away, and POST its members to it.")
        own = written(unmanaged(stated, url))
    put = Put(path, model, own, membership=membership_of(stated, url, model), expected=0)
    return [*_ways_to(robot, path), _as_member(robot, put, stated, url)]


def _as_member(robot: Robot, put: Put, triples: Sequence[Triple], url: str) -> Put:
    """With what stands for it in the membership triples of its container (LDP 5.5.1.2)."""
    container = robot.records.get(container_of(put.path))
    if container is None or container.membership is None:
        return put
    member = member_of(container.membership, body_of(triples), url)
    return replace(put, member=member)


def _ways_to(robot: Robot, path: str) -> list[Put]:
    """The containers to be made first."""
    found: list[Put] = []
    above = container_of(path)
    while above and robot.records.get(above) is None:
        found.insert(0, Put(above, Model.BASIC_CONTAINER, unless_there=True))
        above = container_of(above)
    return found


def require_free(robot: Robot, path: str) -> None:
    """Raise a 409 Problem where the same name is a container already, or is none: a name means one thing."""
    other = path[:-1] if path.endswith("/") else path + "/"
    if robot.records.get(other) is not None:
        raise Problem(409, f"There is {robot.space.base}{other} already: choose another name.")
