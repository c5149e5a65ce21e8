"""The mirror of the dataset in another store (`--store`), with the values of permanently followed topics."""

from __future__ import annotations

import asyncio
import base64
import logging
import pickle
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from urllib.parse import urlsplit

import orjson
from pyoxigraph import NamedNode

from rosld.ontology.document import Document
from rosld.ontology.triples import RDF_SOURCE, date_time_literal, double, integer, text, triples_about
from rosld.ontology.urls import Space
from rosld.ontology.vocab import dcterms, rdf, rdfs, ros
from rosld.server.dataset import Edit
from rosld.server.dataset.endpoint_client import Endpoint, StoreError
from rosld.server.dataset.remote_store import RemoteStore
from rosld.server.dataset.replication import Mirror, ReplicationStatus
from rosld.server.http.origin import is_loopback
from rosld.server.http.problem import Problem
from rosld.server.rest.path_item import PathItem
from rosld.server.rest.resource import Resource
from rosld.server.rest.state import State
from rosld.server.robot.session import Session
from rosld.server.runtime.tasks import loop_time
from rosld.server.settings import Settings
from rosld.server.sparql.materializer import Materializer
from rosld.server.sparql.needs import Needs, needs_of_documents
from rosld.server.sparql.process.client import QueryProcess
from rosld.server.sparql.process.work import DumpGraphs, ListGraphs, Work

ROUTE = "mirror"
"""Path of the mirror's resource, and of its graph in the store."""
_PARAMETERS_EVERY = 10.0
"""Seconds between reads of all parameters, each of which may be a request to the robot."""
_LONGEST_READING = 5.0
"""Seconds to wait for the robot's values before updating the store without them."""
_log = logging.getLogger("rosld.store")


def create_mirror(
    session: Session, instance_id: str, process: QueryProcess, materializer: Materializer, routes: Collection[str]
) -> Mirror | None:
    """Return the mirror of the settings, or None. `routes` are the first segments of all paths of this server.

    Raises ValueError for invalid credentials, OSError for unreadable ones.
    """
    settings = session.settings
    endpoints = settings.store_endpoints
    if endpoints is None:
        return None
    header = None if settings.store_credentials is None else authorization(settings.store_credentials)
    _warn(settings, endpoints)
    query, update = (Endpoint(url, header, seconds=settings.store_time_limit) for url in endpoints)
    return Mirror(
        _Dataset(process, materializer),
        RemoteStore(query, update),
        _Graphs(session.space.base, routes, materializer),
        _Reading(session, materializer).refresh,
        interval=1 / settings.store_rate,
        run_name=instance_id,
    )


def authorization(file: Path) -> str:
    """Return the Authorization header from a file. Raises ValueError, OSError.

    `USER:PASSWORD` is Basic (RFC 7617, in UTF-8); a value that begins with `Bearer` or `Basic` is sent unchanged.
    """
    try:
        text = file.read_text("utf-8").strip()
    except UnicodeDecodeError as error:
        raise ValueError(f"--store-credentials {file}: not valid UTF-8") from error
    scheme, _, rest = text.partition(" ")
    if scheme.lower() in ("basic", "bearer") and rest and rest.isascii() and rest.isprintable():
        return text
    if ":" not in text or not text.isprintable():
        raise ValueError(f"--store-credentials {file}: must contain one line, USER:PASSWORD or 'Bearer TOKEN'")
    return "Basic " + base64.b64encode(text.encode()).decode("ascii")


def _warn(settings: Settings, endpoints: tuple[str, str]) -> None:
    for url in endpoints:
        parts = urlsplit(url)
        if settings.store_credentials is not None and parts.scheme == "http" and not is_loopback(parts.hostname or ""):
            _log.warning("the credentials for %s are sent unencrypted: it is not https", url)


class _Dataset:
    """The dataset of the query process, read by a mirror."""

    def __init__(self, process: QueryProcess, materializer: Materializer) -> None:
        self._process = process
        self._materializer = materializer

    def watch(self, changed: Callable[[Collection[str], Sequence[Edit]], None], restarted: Callable[[], None]) -> None:
        self._process.on_change(changed)
        self._process.starts.watch(restarted)

    def graphs(self) -> Collection[str]:
        names: list[str] = pickle.loads(self._result(ListGraphs()))  # from this process
        return names

    def ntriples(self, graph: str) -> str | None:
        texts: dict[str, str | None] = pickle.loads(self._result(DumpGraphs((graph,))))
        return texts[graph]

    def _result(self, work: Work) -> bytes:
        if self._materializer.stored.progress is not None:
            raise StoreError(self._materializer.stored.progress)
        try:
            return self._process.result_for_thread(work, _LONGEST_READING)
        except (Problem, TimeoutError) as error:
            raise StoreError(f"The dataset cannot be read now: {error}.") from error


class _Graphs:
    """The graphs of this server in a shared store: those in its routes, as its base may be a prefix of another base."""

    def __init__(self, base: str, routes: Collection[str], materializer: Materializer) -> None:
        self.base = base
        self.heartbeat_graph = base + ROUTE
        self._routes = frozenset(routes)
        self._materializer = materializer

    def is_ours(self, graph: str) -> bool:
        path = graph.removeprefix(self.base)
        route = path.partition("/")[0].partition("?")[0].partition("#")[0]
        return len(path) < len(graph) and route in self._routes

    def transient_graphs(self) -> Collection[str]:
        return self._materializer.source_graphs


class _Reading:
    """Refresher of the dataset: descriptions, stored documents, followed topics, and periodically parameters."""

    def __init__(self, session: Session, materializer: Materializer) -> None:
        self._session = session
        self._materializer = materializer
        self._parameters_at = float("-inf")

    async def refresh(self) -> None:
        await asyncio.wait_for(self._read(self._topics()), _LONGEST_READING)
        now = loop_time()
        if now - self._parameters_at >= _PARAMETERS_EVERY:
            self._parameters_at = now
            await asyncio.wait_for(self._read(self._parameters()), _LONGEST_READING)

    async def _read(self, needs: Needs) -> None:
        async with self._materializer.materialize(needs, deadline=loop_time() + _LONGEST_READING):
            pass

    def _topics(self) -> Needs:
        space = self._session.space
        topics = map(space.topic, self._session.topics.always_subscribed())
        return needs_of_documents([*topics, space.container("activity"), space.base])

    def _parameters(self) -> Needs:
        urls = frozenset(map(self._session.space.parameter, self._session.graph.parameters))
        return needs_of_documents(urls)


class ReplicationResource(Resource):
    """The progress of the replication to another store."""

    kind = "Mirror"
    item = PathItem("The mirror of the dataset in another store")

    def __init__(self, space: Space, mirror: Mirror) -> None:
        super().__init__(space, space.base + ROUTE)
        self._mirror = mirror

    async def state(self) -> State:
        status = self._mirror.status
        return State(lambda: replication_document(self.url, status), lambda: _plain(status))


def replication_document(url: str, status: ReplicationStatus) -> Document:
    """Return the document of a mirror, marked stale with the reason while its store is unreachable."""
    return Document(
        url,
        tuple(
            triples_about(
                NamedNode(url),
                (rdf.type, ros.Mirror),
                *RDF_SOURCE,
                (rdfs.label, text("Mirror of the dataset")),
                (ros.store, NamedNode(status.url)),
                (ros.state, ros.Live if status.failure is None else ros.Stale),
                (ros.reason, text(status.failure)),
                (ros.words, text(status.words)),
                (ros.lag, double(round(status.lag, 3))),
                (ros.pending, integer(status.pending)),
                (ros.refusedGraphs, integer(status.refused)),
                (dcterms.modified, date_time_literal(status.updated_ns)),
            )
        ),
    )


def _plain(status: ReplicationStatus) -> bytes:
    return orjson.dumps(
        {
            "store": status.url,
            "failure": status.failure,
            "words": status.words,
            "lag": round(status.lag, 3),
            "pending": status.pending,
            "refused": status.refused,
        }
    )
