"""A robot of many topics as a source of graphs, and a query service over it. Nothing of it talks to ROS."""

from __future__ import annotations

import asyncio
import pickle
import time
from collections.abc import Callable, Collection, Coroutine, Mapping, Sequence
from typing import Any, ClassVar, TypeVar

import pytest
from hypothesis import settings

from rosld.server.sparql.analysis import Analyser
from rosld.server.sparql.graph_source import GraphEntry
from rosld.server.sparql.materializer import Materializer
from rosld.server.sparql.needs import Needs
from rosld.server.sparql.process.client import QueryProcess
from rosld.server.sparql.process.work import DumpGraphs, ListGraphs
from rosld.server.sparql.protocol import QueryRequest
from rosld.server.sparql.query_service import QueryAnswer, QueryService, QuerySettings

BASE = "http://robot/"
TYPES = "https://w3id.org/rosld/types/"
ROS = "https://w3id.org/rosld#"
TYPE = "http://www.w3.org/1999/02/22-rdf-syntax-ns#type"
DOUBLE = "http://www.w3.org/2001/XMLSchema#double"
SETTINGS = QuerySettings()

# A machine that is busy with other things is no failure of what is tested.
settings.register_profile("unhurried", deadline=None)
settings.load_profile("unhurried")
_T = TypeVar("_T")


class RobotSource:
    """`count` topics `t0`, `t1`, ...; topic n has messages of type `p/msg/T{n % 10}` with `fields` doubles."""

    def __init__(self, count: int = 20, fields: int = 3) -> None:
        self.count = count
        self.fields = fields
        self.revision = 0
        self.writes = 0
        self.values: dict[int, int] = dict.fromkeys(range(count), 0)
        self.silent: set[int] = set()
        self.bags: dict[str, str] = {}
        self.unnamed: dict[str, str] = {}
        """As `bags`, but there for who looks at everything."""
        self.looks: list[Needs] = []
        self.rendered: list[str] = []
        self.pause: Callable[[], Coroutine[Any, Any, None]] | None = None
        self.delay: Callable[[], Coroutine[Any, Any, None]] | None = None

    def url(self, topic: int) -> str:
        return f"{BASE}topics/t{topic}"

    def tick(self) -> None:
        """A new message on every topic."""
        for topic in self.values:
            self.values[topic] += 1

    def descriptions(self) -> Mapping[str, GraphEntry]:
        return {self.url(topic): self._entry(topic, False) for topic in range(self.count)}

    async def documents_of(self, terms: Collection[str]) -> Collection[str]:
        return ()

    async def live(self, needs: Needs, *, deadline: float) -> Sequence[GraphEntry]:
        self.looks.append(needs)
        if self.pause is not None:
            await self.pause()
        found = [
            self._entry(topic, True)
            for topic in self._named(needs)
            if topic not in self.silent and needs.wants_topic(self.url(topic), {f"p/msg/T{topic % 10}"})
        ]
        found += [self._bag(iri, words) for iri, words in self.bags.items() if iri in needs.documents]
        found += [
            self._bag(iri, words)
            for iri, words in self.unnamed.items()
            if needs.is_everything or iri in needs.documents
        ]
        if self.delay is not None:
            await self.delay()
        return found

    def _named(self, needs: Needs) -> Sequence[int]:
        if needs.graphs is None:
            return range(self.count)
        start = f"{BASE}topics/t"
        named = [int(iri.removeprefix(start)) for iri in sorted(needs.graphs) if iri.startswith(start)]
        return [topic for topic in named if topic < self.count]

    def _bag(self, iri: str, words: str) -> GraphEntry:
        return GraphEntry(iri, words, lambda: f'<{iri}> <{ROS}words> "{words}" .\n')

    def _entry(self, topic: int, live: bool) -> GraphEntry:
        url, value = self.url(topic), self.values[topic]

        def ntriples() -> str:
            self.rendered.append(url)
            return self._described(url) + (self.message(url, topic, value) if live else "")

        return GraphEntry(url, (self.revision, value) if live else self.revision, ntriples)

    def _described(self, url: str) -> str:
        return (
            f"<{url}> <{TYPE}> <{ROS}Topic> .\n"
            f'<{url}> <{ROS}name> "{url.removeprefix(BASE + "topics")}" .\n'
            f"<{url}> <{ROS}namespace> <{BASE}revisions/{self.revision}> .\n"
        )

    def message(self, url: str, topic: int, value: int) -> str:
        fields = "".join(
            f'<{url}#message> <{TYPES}p/msg/T{topic % 10}#f{at}> "{value + at}.5"^^<{DOUBLE}> .\n'
            for at in range(self.fields)
        )
        return f"<{url}> <{ROS}latest> <{url}#message> .\n{fields}"


class Endpoint:
    """A query service over a source, for use within one running loop."""

    running: ClassVar[list[Endpoint]] = []

    def __init__(self, source: RobotSource, settings: QuerySettings = SETTINGS, interval: float = 0.2) -> None:
        self.source = source
        self.process = QueryProcess(settings.workers, settings.waiting)
        self.materializer = Materializer(self.process, source, interval=interval)
        self.service = QueryService(self.process, self.materializer, Analyser(BASE, TYPES), dict, settings)

    async def start(self) -> None:
        """Have its process, which ends with the loop."""
        if self not in self.running:
            self.running.append(self)
            await self.process.start()
            await self.graphs()

    async def answer(self, query: str, accept: str | None = "text/csv") -> QueryAnswer:
        await self.start()
        return await self.service.answer(QueryRequest(query), accept)

    async def graphs(self) -> list[str]:
        """The graphs that the process holds."""
        names: list[str] = pickle.loads(
            await self.process.result(ListGraphs(), self.service.limits, time.monotonic() + 30)
        )
        return names

    async def graph(self, name: str) -> str:
        """What the process holds of a graph, as N-Triples."""
        dump = await self.process.result(DumpGraphs((name,)), self.service.limits, time.monotonic() + 30)
        texts: dict[str, str] = pickle.loads(dump)
        return texts[name]

    async def text(self, query: str, accept: str | None = "text/csv") -> str:
        """The whole answer."""
        body = (await self.answer(query, accept)).body
        return (body if isinstance(body, bytes) else b"".join([chunk async for chunk in body])).decode()

    async def rows(self, query: str) -> list[str]:
        """The sorted rows of a SELECT."""
        return sorted((await self.text(query)).split("\r\n")[1:-1])


@pytest.fixture
def make_source() -> type[RobotSource]:
    return RobotSource


@pytest.fixture
def make_endpoint() -> type[Endpoint]:
    return Endpoint


@pytest.fixture
def run() -> Callable[[Coroutine[Any, Any, _T]], _T]:
    """Runs a coroutine on a loop of its own."""

    def running(coroutine: Coroutine[Any, Any, _T]) -> _T:
        return asyncio.run(asyncio.wait_for(ended(coroutine), 60))

    async def ended(coroutine: Coroutine[Any, Any, _T]) -> _T:
        try:
            return await coroutine
        finally:
            while Endpoint.running:
                await Endpoint.running.pop().process.close()

    return running
