"""RDF sources, and the descriptions of files (LDP 4.3)."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence

from pyoxigraph import Triple

from rosld.server.html import DeleteForm, Form
from rosld.server.http.multipart import MULTIPART
from rosld.server.http.problem import Problem
from rosld.server.ldp.exchange import Exchange
from rosld.server.ldp.n3patch import applied, read_patch
from rosld.server.ldp.patch import updated
from rosld.server.ldp.plan import Keep
from rosld.server.ldp.prepared import done
from rosld.server.ldp.resource import (
    RDF_BODIES,
    SPARQL_UPDATE,
    Answer,
)
from rosld.server.ldp.state import State
from rosld.server.records import Model, Put, Record, Remove, Write
from rosld.server.records.describe import META, may_be_managed, written
from rosld.server.resources.kept.base import Kept
from rosld.server.resources.kept.bodies import (
    as_statements,
    own_triples,
    require_contained,
    require_membership,
    require_model,
    require_same_members,
    statements,
    triples_of,
)
from rosld.server.resources.kept.merging import apart, unite
from rosld.server.resources.kept.showing import shown
from rosld.server.robot import Robot

N3_PATCH = "text/n3"


class SourceResource(Kept):
    """An RDF source."""

    kind = "RDF source"
    writes = frozenset({"PUT", "POST", "PATCH", "DELETE"})
    in_turn = frozenset({"POST", "PATCH"})
    accepts: Mapping[str, Sequence[str]] = {
        "PUT": RDF_BODIES,
        "POST": (*RDF_BODIES, MULTIPART),
        "PATCH": (SPARQL_UPDATE, N3_PATCH),
    }

    async def state(self) -> State:
        return shown(self.robot, self.there())

    async def forms(self) -> Sequence[Form]:
        return [DeleteForm("Delete it")] if "DELETE" in self.methods() else []

    async def put(self, exchange: Exchange) -> Answer:
        self.require_guard(exchange)
        require_model(exchange, self.there().model, self.url)
        triples = await statements(exchange, self.document_url)

        async def replaced(record: Record) -> Write:
            put = self.with_triples(record, triples)
            whole = record.model is Model.RDF_SOURCE and not exchange.is_conditional
            return Put(put.path, put.model, put.triples) if whole else put  # the last one counts, whatever was there

        await self.change(exchange, replaced)
        return done()

    async def post(self, exchange: Exchange) -> Answer:
        """The body is merged into what is here (SPARQL 1.1 Graph Store Protocol 5.5)."""
        self.require_guard(exchange)
        if exchange.essence == MULTIPART:
            await unite(exchange, self.document_url)
        added = apart(await statements(exchange, self.document_url))

        async def merged(record: Record) -> Write:
            before = shown(self.robot, record).document.triples
            return self.with_triples(record, list(dict.fromkeys((*before, *added))))

        await self.change(exchange, merged)
        return done()

    async def patch(self, exchange: Exchange) -> Answer:
        self.require_guard(exchange)
        patched = await self._patch(exchange)

        async def changed(record: Record) -> Write:
            before = shown(self.robot, record).document.triples
            after = await asyncio.to_thread(patched, before)  # a hostile one takes its time
            require_same_members(before, after, self.url)
            return self.with_triples(record, after)

        await self.change(exchange, changed)
        return done()

    async def _patch(self, exchange: Exchange) -> Callable[[Sequence[Triple]], Sequence[Triple]]:
        """What a patch makes of triples. Raises Problems for what is no patch."""
        data, url = await exchange.body(), self.document_url
        if exchange.media_type == N3_PATCH:
            patch = await asyncio.to_thread(read_patch, data, url)
            return lambda before: applied(patch, before)
        return lambda before: triples_of(updated(data, before, url))

    async def planned(self, triples: Sequence[Triple] | None) -> Keep:
        method = "DELETE" if triples is None else "PUT"
        if method not in self.methods():
            raise Problem(403, self.why_not(method))
        if triples is None:
            return Keep(f"delete {self.title}", (Remove(self.path, self.there().version),))
        return Keep(f"store {self.title}", (self.with_triples(self.there(), triples),))

    @property
    def document_url(self) -> str:
        """What relative IRIs are resolved against."""
        return self.url

    def with_triples(self, record: Record, triples: Sequence[Triple]) -> Put:
        """The record with these triples; those that are the server's to say must be as they are, or away."""
        stated = as_statements(triples)
        own = stated.ntriples
        if record.membership is not None or may_be_managed(own):
            require_contained(self.robot, record, stated)
            if record.membership is not None:
                require_membership(record.membership, stated, self.robot.space.base + record.path, record.model)
            own = written(own_triples(self.robot, record, stated))
        return Put(record.path, record.model, own, record.blob, record.membership, expected=record.version)


class DescriptionResource(SourceResource):
    """The description of a file, at its URL and `.meta`: it comes and goes with the file (LDP 4.2.1.6, 5.2.3.12)."""

    kind = "Description"
    writes = frozenset({"PUT", "POST", "PATCH"})
    in_turn = frozenset({"PUT", "POST", "PATCH"})

    def __init__(self, robot: Robot, path: str) -> None:
        super().__init__(robot, path.removesuffix(META))
        self.url = robot.space.base + path
        self.title = "/" + path

    async def forms(self) -> Sequence[Form]:
        return ()
