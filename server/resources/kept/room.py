"""`/data/` and below: which resource a path is, as what is recorded now has it."""

from __future__ import annotations

from collections.abc import Sequence

from pyoxigraph import Triple

from rosld.ontology.urls import Location
from rosld.server.http.problem import Problem
from rosld.server.ldp.exchange import Exchange
from rosld.server.ldp.plan import Keep
from rosld.server.ldp.resource import (
    RDF_BODIES,
    Answer,
    Resource,
    moved,
)
from rosld.server.ldp.state import State
from rosld.server.records import Blob, Cause, Conflict, Model
from rosld.server.records.describe import META
from rosld.server.resources.kept.base import Kept, missing, told
from rosld.server.resources.kept.bodies import asked_model, received, require_model
from rosld.server.resources.kept.containers import creation, resource_of
from rosld.server.resources.kept.files import KeptFile
from rosld.server.resources.kept.making import making, require_free
from rosld.server.resources.kept.showing import shown
from rosld.server.resources.kept.sources import DescriptionResource
from rosld.server.robot import Robot


class AbsentResource(Kept):
    """Nothing yet: PUT makes it."""

    kind = "Absent"
    writes = frozenset({"PUT"})
    links = ()
    merges = False
    """Whether what is sent is added to what others make here meanwhile, and does not replace it."""

    def __init__(self, robot: Robot, path: str) -> None:
        super().__init__(robot, path)
        self.accepts = {"PUT": self.makes}

    async def narrowed(self, exchange: Exchange) -> Resource:
        if exchange.method not in ("PUT", "OPTIONS"):
            raise missing(self.robot, self.path)
        return self

    async def state(self) -> State:
        found = self.robot.records.get(self.path)
        if found is None:
            raise missing(self.robot, self.path)
        return shown(self.robot, found)  # it was made while this request waited for its turn

    def streams(self, exchange: Exchange) -> bool:
        return self._model(exchange) is Model.NON_RDF_SOURCE

    def _model(self, exchange: Exchange) -> Model:
        return asked_model(exchange, self.url, container=self.url.endswith("/"))

    async def planned(self, triples: Sequence[Triple] | None) -> Keep:
        if "PUT" not in self.methods():
            raise Problem(403, self.why_not("PUT"))
        if triples is None:
            raise missing(self.robot, self.path)
        model = Model.BASIC_CONTAINER if self.path.endswith("/") else Model.RDF_SOURCE
        return Keep(f"make {self.title}", tuple(await making(self.robot, self.path, model, triples)))

    async def put(self, exchange: Exchange) -> Answer:
        model, blob = self._model(exchange), None
        if model is Model.NON_RDF_SOURCE:
            require_free(self.robot, self.path)
            blob = await received(self.robot, exchange)
        try:
            return await creation(self.robot, self.path, model, exchange, blob)
        except Conflict as error:
            if error.path != self.path or error.cause is not Cause.THERE:
                raise told(self.robot, error) from error
        if exchange.is_conditional:
            raise Problem(412, f"{self.url} was made by another request meanwhile; nothing was done.")
        return await self._once_more(exchange, blob)

    async def _once_more(self, exchange: Exchange, blob: Blob | None) -> Answer:
        """The same write of what another request has made meanwhile: of those without a condition the last one wins."""
        record = self.there()
        there = resource_of(self.robot, self.path, record.model)
        if isinstance(there, KeptFile):
            require_model(exchange, record.model, self.url)
            return await there.replaced(exchange, record, blob or await received(self.robot, exchange))
        if blob is not None:
            raise Problem(415, f"PUT takes {', '.join(RDF_BODIES)} here, not {blob.media_type}.")
        return await (there.post(exchange) if self.merges else there.put(exchange))


def missing_description(robot: Robot, path: str) -> Problem:
    """410 where the description went with its file (LDP 5.2.5.2), else 404: it comes with a file and not otherwise."""
    file = path.removesuffix(META)
    if robot.records.was_there(file):
        return Problem(410, f"/{file} was deleted, and its description with it.")
    return Problem(
        404, f"/{path} would describe a file at /{file}, and there is none: PUT the file, and it comes along."
    )


def kept_room(robot: Robot, location: Location) -> Resource:
    """`/data/` and below: as what is recorded now has it."""
    if not location.segments and not location.is_container:
        raise moved(robot.space.container(location.kind))
    path = robot.space.url(location.kind, location.segments)[len(robot.space.base) :]
    if location.is_container:
        path += "/"
    record = robot.records.get(path)
    if record is not None:
        return resource_of(robot, path, record.model)
    if path.endswith(META):
        described = robot.records.get(path.removesuffix(META))
        if described is None or described.model is not Model.NON_RDF_SOURCE:
            raise missing_description(robot, path)
        return DescriptionResource(robot, path)
    return AbsentResource(robot, path)
