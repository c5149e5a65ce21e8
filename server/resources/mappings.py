"""Mapping documents: `/mappings/` lists those in force, `/mappings/NAME` is one (LDP 4, 5).

A document is judged before anything changes, and takes effect at once when it is found good.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Mapping, Sequence

from starlette.responses import Response

from rosld.ontology.describe_containers import container_document
from rosld.ontology.document import Document
from rosld.ontology.urls import Location
from rosld.server.html import DeleteForm, Form
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.documents import MappingDocument, mapping_of, read_mapping
from rosld.server.ldp.exchange import Exchange
from rosld.server.ldp.patch import updated
from rosld.server.ldp.resource import (
    BASIC_CONTAINER,
    RDF_BODIES,
    RDF_SOURCE,
    READ,
    RESOURCE,
    SPARQL_UPDATE,
    Answer,
    Created,
    Resource,
    moved,
)
from rosld.server.ldp.state import State
from rosld.server.robot import Robot, Same

_MOST_SLUG = 100


class _Mappings(Resource):
    """What one document and the container have in common."""

    writes: frozenset[str] = frozenset()

    def __init__(self, robot: Robot, url: str) -> None:
        super().__init__(url)
        self.robot = robot

    def methods(self) -> frozenset[str]:
        return READ if self.robot.settings.read_only else READ | self.writes

    def why_not(self, method: str) -> str:
        if self.robot.settings.read_only:
            return "This server is read-only."
        return f"{self.kind} resources do not answer {method}."

    @property
    def constrained_by(self) -> str:
        return self.robot.space.shape("mapping")


class MappingResource(_Mappings):
    """One mapping document: exactly the RDF that was put."""

    kind = "Mapping"
    writes = frozenset({"PUT", "PATCH", "DELETE"})
    accepts: Mapping[str, Sequence[str]] = {"PUT": RDF_BODIES, "PATCH": (SPARQL_UPDATE,)}

    def __init__(self, robot: Robot, name: str) -> None:
        super().__init__(robot, robot.space.url("mappings", (name,)))
        self.title = name

    async def state(self) -> State:
        return self._shown(self._there())

    def _there(self) -> MappingDocument:
        found = self.robot.mappings.documents.get(self.url)
        if found is None:
            raise Problem(
                404, f"There is no mapping {self.title}; {self.robot.space.container('mappings')} lists them."
            )
        return found

    def _shown(self, document: MappingDocument) -> State:
        described = Document(self.url, document.triples)
        return self.robot.states.get(self.url, Same(document), lambda: State(lambda: described))

    async def forms(self) -> Sequence[Form]:
        return [DeleteForm("Delete the mapping")] if "DELETE" in self.methods() else []

    async def put(self, exchange: Exchange) -> Answer:
        data, media_type = await exchange.body(), exchange.media_type
        before = self.robot.mappings.documents.get(self.url)
        document = await self._judged(before, lambda: read_mapping(data, media_type, self.url))
        self.robot.mappings.replace(document)
        self.robot.changes.give()
        if before is None:
            return Created(self.url, self, self._shown(document))
        return Response(status_code=204)

    async def patch(self, exchange: Exchange) -> Answer:
        data = await exchange.body()
        before = self._there()
        document = await self._judged(before, lambda: mapping_of(updated(data, before.triples, self.url), self.url))
        self.robot.mappings.replace(document)
        self.robot.changes.give()
        return Response(status_code=204)

    async def _judged(self, before: MappingDocument | None, read: Callable[[], MappingDocument]) -> MappingDocument:
        """The new document, read on a thread, for a large one takes its time.

        What was there when preconditions were judged must still be there afterwards: else 409.
        """
        document = await asyncio.to_thread(read)
        if self.robot.mappings.documents.get(self.url) is not before:
            raise Problem(409, f"The mapping {self.title} was changed by somebody else meanwhile: read it, then retry.")
        return document

    async def delete(self, exchange: Exchange) -> Answer:
        self._there()
        self.robot.mappings.remove(self.url)
        self.robot.changes.give()
        return Response(status_code=204)


class MappingContainer(_Mappings):
    """`/mappings/`."""

    kind = "Mappings"
    title = "Mappings"
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)
    writes = frozenset({"POST"})
    accepts: Mapping[str, Sequence[str]] = {"POST": RDF_BODIES}

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot, robot.space.container("mappings"))

    async def state(self) -> State:
        documents = self.robot.mappings.documents
        return self.robot.states.get(
            self.url, Same(documents), lambda: State(lambda: container_document(self.url, documents, "Mappings"))
        )

    async def post(self, exchange: Exchange) -> Answer:
        """A new document, named by Slug where that is free (LDP 5.2.3.10)."""
        return await MappingResource(self.robot, self._free_name(exchange.header("slug"))).put(exchange)

    def _free_name(self, slug: str | None) -> str:
        kept = "".join(char if char.isalnum() or char in "_-" else "_" for char in (slug or "")[:_MOST_SLUG])
        name = kept or f"mapping_{secrets.token_hex(3)}"
        taken = self.robot.space.url("mappings", (name,)) in self.robot.mappings.documents
        return f"{name}_{secrets.token_hex(3)}" if taken else name


def mapping_room(robot: Robot, location: Location) -> Resource:
    """`/mappings/` and below."""
    match location.segments:
        case () if location.is_container:
            return MappingContainer(robot)
        case ():
            raise moved(robot.space.container("mappings"))
        case (name,) if not location.is_container:
            return MappingResource(robot, name)
    raise Problem(404, f"A mapping lies directly under {robot.space.container('mappings')}")
