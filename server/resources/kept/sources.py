"""RDF sources, and the descriptions of files (LDP 4.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pyoxigraph import Triple
from starlette.responses import Response

from rosld.server.html import DeleteForm, Form
from rosld.server.ldp.exchange import Exchange
from rosld.server.ldp.n3patch import applied, read_patch
from rosld.server.ldp.patch import updated
from rosld.server.ldp.resource import (
    RDF_BODIES,
    SPARQL_UPDATE,
    Answer,
)
from rosld.server.ldp.state import State
from rosld.server.records import Put, Record
from rosld.server.records.describe import META, written
from rosld.server.resources.kept.base import Kept
from rosld.server.resources.kept.bodies import (
    own_triples,
    require_contained,
    require_membership,
    require_model,
    require_same_members,
    statements,
    triples_of,
)
from rosld.server.resources.kept.showing import shown
from rosld.server.robot import Robot

N3_PATCH = "text/n3"


class SourceResource(Kept):
    """An RDF source."""

    kind = "RDF source"
    writes = frozenset({"PUT", "PATCH", "DELETE"})
    accepts: Mapping[str, Sequence[str]] = {"PUT": RDF_BODIES, "PATCH": (SPARQL_UPDATE, N3_PATCH)}

    async def state(self) -> State:
        return shown(self.robot, self.there())

    async def forms(self) -> Sequence[Form]:
        return [DeleteForm("Delete it")] if "DELETE" in self.methods() else []

    async def put(self, exchange: Exchange) -> Answer:
        self.require_guard(exchange)
        record = self.there()
        require_model(exchange, record.model, self.url)
        body = await statements(exchange, self.document_url)
        await self.replace(record, triples_of(body))
        return Response(status_code=204)

    async def patch(self, exchange: Exchange) -> Answer:
        self.require_guard(exchange)
        record, data = self.there(), await exchange.body()
        document = (await self.state()).document
        if exchange.media_type == N3_PATCH:
            after: Sequence[Triple] = applied(read_patch(data, self.document_url), document.triples)
        else:
            after = triples_of(updated(data, document.triples, self.document_url))
        require_same_members(document.triples, after, self.url)
        await self.replace(record, after)
        return Response(status_code=204)

    @property
    def document_url(self) -> str:
        """What relative IRIs are resolved against."""
        return self.url

    async def replace(self, record: Record, triples: Sequence[Triple]) -> None:
        """Keep these triples instead; those that are the server's to say must be as they are, or away."""
        require_contained(self.robot, record, triples)
        url = self.robot.space.base + record.path
        if record.membership is not None:
            require_membership(record.membership, triples, url, record.model)
        own = own_triples(self.robot, record, triples)
        await self.do(
            Put(
                record.path,
                record.model,
                written(own),
                record.blob,
                record.membership,
                record.member,
                expected=record.version,
            )
        )


class DescriptionResource(SourceResource):
    """The description of a file, at its URL and `.meta`: it comes and goes with the file (LDP 4.2.1.6, 5.2.3.12)."""

    kind = "Description"
    writes = frozenset({"PUT", "PATCH"})

    def __init__(self, robot: Robot, path: str) -> None:
        super().__init__(robot, path.removesuffix(META))
        self.url = robot.space.base + path
        self.title = "/" + path

    async def forms(self) -> Sequence[Form]:
        return ()
