"""Search at `/find?q=battery`: everything of the robot that matches the words (schema:ItemList, hydra:search)."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Protocol
from urllib.parse import quote

import orjson
from msgspec import Struct
from pyoxigraph import NamedNode

from rosld.adapters.base import Capabilities
from rosld.adapters.model import Graph, RosError
from rosld.ontology.describe_faults import Fault
from rosld.ontology.describe_views import (
    MemberOutline,
    SearchOutline,
    SearchResult,
    search_document,
    search_template,
    unasked_document,
)
from rosld.ontology.document import Document
from rosld.ontology.names import IdentityCache, namespaces_of
from rosld.ontology.urls import Location, Space, locate
from rosld.ontology.vocab import dcterms, rdfs, ros, schema_org
from rosld.server.auth.permissions import Permissions
from rosld.server.html.forms import Form
from rosld.server.html.page import Csrf, Notice, SearchPage, Thumbnail
from rosld.server.html.render import render_search
from rosld.server.html.site import Site
from rosld.server.http.conditional import digest
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.affordance_service import AffordanceService
from rosld.server.hypermedia.brief_value import LatestValue, brief_json
from rosld.server.hypermedia.catalogue import ParameterSource, Property, TopicSource
from rosld.server.hypermedia.conditions import url_of
from rosld.server.hypermedia.json_schema import NUMBER, TEXT, URI, Json, JsonSchema, json_array, json_object
from rosld.server.hypermedia.resource_tree import ResourceTree, path_of, segments_of
from rosld.server.hypermedia.type_inference import is_light
from rosld.server.hypermedia.value import Reading
from rosld.server.policies import stored_cockpits
from rosld.server.policies.stored_mappings import ROUTE
from rosld.server.resources.base import Services, SessionResource
from rosld.server.resources.ldp.base import Documents
from rosld.server.resources.namespaces import listed_graph, namespaces, things_of, thumbnail
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import FORMAT, PathItem, QueryParameter
from rosld.server.rest.resource import RDF_SOURCE, RESOURCE, Resource
from rosld.server.rest.responses import offer_url
from rosld.server.rest.state import State
from rosld.server.robot.session import Session
from rosld.server.runtime.tasks import loop_time
from rosld.server.runtime.version_cache import IdentityKey
from rosld.server.search.catalog import catalog_of
from rosld.server.search.index import Catalog, Entry, EntryKind, Hit, Match, SearchIndex, SearchResults
from rosld.server.search.near_names import NearNames
from rosld.server.search.thesaurus import PHRASES
from rosld.server.search.words import Query, read_query
from rosld.server.storage.record import Record
from rosld.server.storage.record_documents import unpack_prefix

MAX_KEPT = 500
"""Maximum number of indexed documents, nearest to the root first; SPARQL covers the others."""
_MAX_BYTES = 8192
"""Number of bytes at the start of a document that are searched for titles."""
_AT_ONCE = 25
"""Number of documents read before yielding to the loop."""
_NAMING = "|".join(map(re.escape, (dcterms.title.value, rdfs.label.value, schema_org.name.value)))
_TITLES = re.compile(rf'<(?:{_NAMING})> "((?:[^"\\]|\\.)*)"'.encode())
_ROOTS = (ROUTE, stored_cockpits.ROUTE, "data/")


async def kept_entries(documents: Documents) -> list[Entry]:
    """Return the entries of stored queries and documents, at most `MAX_KEPT` each."""
    found = [
        Entry(EntryKind.QUERY, f"/{query.name}", url, (), (query.purpose,))
        for url, query in documents.queries.all(limit=MAX_KEPT)
    ]
    waiting, count = list(_ROOTS), 0
    while waiting and count < MAX_KEPT:
        for member in documents.records.members(waiting.pop(0), limit=MAX_KEPT - count):
            record = documents.records.get(member.path)
            if record is None:
                continue
            count += 1
            found.append(_entry(documents.space, record))
            if record.model.is_container:
                waiting.append(record.path)
            if count % _AT_ONCE == 0:
                await asyncio.sleep(0)
    return found


def _entry(space: Space, record: Record) -> Entry:
    kind = EntryKind.MAPPING if record.path.startswith(ROUTE) else EntryKind.DOCUMENT
    return Entry(kind, _name(record.path), space.base + record.path, (), tuple(titles_in(record.triples)))


def _name(path: str) -> str:
    """Return the decoded path below its route."""
    return "/" + "/".join(locate(f"/{path}").segments)


def titles_in(triples: bytes) -> list[str]:
    """Return the titles and labels at the start of packed N-Triples."""
    found = _TITLES.findall(unpack_prefix(triples, _MAX_BYTES))
    return [text.decode("utf-8", "replace").replace('\\"', '"') for text in found]


_MANY_NAMES = 1000
"""Number of names above which an index is built on a thread: ten thousand take a quarter of a second."""


class _Index(Struct, frozen=True, eq=False):
    """An index with the version of its source."""

    version: Hashable
    index: SearchIndex


class Finder:
    """The search of one robot."""

    def __init__(self, services: Services) -> None:
        self._services = services
        self._session = services.session
        self._documents = services.documents
        self._of_robot: _Index | None = None
        self._of_kept: _Index | None = None
        self._making = asyncio.Lock()

    async def find(self, query: Query, permissions: Permissions, limit: int) -> SearchResults:
        """Return at most `limit` readable entries that match all terms, or as many as possible, best first."""
        async with self._making:
            self._of_robot = await self._robot_index(self._of_robot)
            self._of_kept = await self._kept_index(self._of_kept)
        may_read: Callable[[str], bool] | None = None if permissions.is_unrestricted else permissions.may_read
        faults = [_fault_entry(self._session.space, each) for each in self._services.faults.all()]
        indexes = (self._of_robot.index, self._of_kept.index, SearchIndex(Catalog(faults), by_meaning=False))
        found = [each.find(query, limit, may_read) for each in indexes]
        return SearchResults.merge(found, query, limit)

    async def _robot_index(self, known: _Index | None) -> _Index:
        tree = await self._services.affordances.tree()
        graph = listed_graph(self._session.graph, self._session.adapter.capabilities)
        version = (IdentityKey(graph), IdentityKey(tree), self._session.schemas.count)
        if known is not None and known.version == version:
            return known
        make = partial(_index_of_robot, self._session, graph, tree)
        names = len(graph.topics) + len(graph.services) + len(graph.parameters)
        return _Index(version, await asyncio.to_thread(make) if names > _MANY_NAMES else make())

    async def _kept_index(self, known: _Index | None) -> _Index:
        version = self._documents.records.version
        if known is not None and known.version == version:
            return known
        entries = await kept_entries(self._documents)
        return _Index(version, SearchIndex(Catalog(entries), by_meaning=False))


def _fault_entry(space: Space, fault: Fault) -> Entry:
    return Entry(EntryKind.FAULT, f"/{fault.key.label.lstrip('/')}", space.fault(fault.id), (), (fault.words,))


def _index_of_robot(session: Session, graph: Graph, tree: ResourceTree) -> SearchIndex:
    writes = session.adapter.capabilities.writes and not session.settings.read_only
    find_schema, permitted = session.schemas.find_similar, session.settings.allow_publish
    return SearchIndex(catalog_of(graph, find_schema, tree, session.space, writes=writes, allow_publish=permitted))


_IN_GRAPH = frozenset({"nodes", "topics", "services", "actions", "parameters"})


def _near_in_route(things: Mapping[str, object]) -> NearNames:
    return NearNames((*things, *(path_of(namespace) for namespace in namespaces_of(things) if namespace)))


def _near_in_tree(tree: ResourceTree) -> NearNames:
    return NearNames({*tree.properties, *tree.actions, *tree.paths} - {"/"})


_route_names: IdentityCache[Mapping[str, object], NearNames] = IdentityCache(_near_in_route)
_tree_names: IdentityCache[ResourceTree, NearNames] = IdentityCache(_near_in_tree, 2)


def near_urls(services: Services, url: str) -> Sequence[str]:
    """Return URLs with existing names similar to the missing one in `url`, most similar first.

    Empty if `url` has no name, or if its name exists and the resource is absent for another reason.
    """
    space, adapter = services.space, services.session.adapter
    place = space.location(url)
    if place is None or not place.segments:
        return ()
    if place.kind == "resources":
        return _near_resources(space, services.affordances, place)
    return _near_names(space, adapter.graph, adapter.capabilities, place) if place.kind in _IN_GRAPH else ()


def _near_names(space: Space, graph: Graph, capabilities: Capabilities, place: Location) -> Sequence[str]:
    things, name = things_of(listed_graph(graph, capabilities), place.kind), _missing_name(place)
    if name in things or place.segments in namespaces(graph, place.kind):
        return ()
    return [
        space.container(place.kind, segments_of(each))
        if each.endswith("/")
        else space.url(place.kind, tuple(each[1:].split("/")))
        for each in _route_names(things).of(name)
    ]


def _near_resources(space: Space, affordances: AffordanceService[State], place: Location) -> Sequence[str]:
    tree, name = affordances.cached_tree(), _missing_name(place)
    if tree is None or tree.property(name) is not None or tree.action(name) is not None or f"{name}/" in tree.paths:
        return ()
    return [url_of(each, space) for each in _tree_names(tree).of(name)]


def _missing_name(place: Location) -> str:
    return "/" + "/".join(place.segments)


MAX_RESULTS = 20
MAX_BYTES = 5000
"""Maximum size in bytes of results in JSON; values are omitted before results."""
_PARAMETER_SECONDS = 0.3
"""Seconds to wait for the values of matching parameters."""
_QUERY = QueryParameter("q", "Words of names, types, fields, titles, units and descriptions, or a question.")
_VALUES = QueryParameter(
    "values",
    "Whether to subscribe briefly to the topics found, except images, clouds, maps and scans.",
    {"type": "boolean"},
)
_CLASSES: Mapping[EntryKind, NamedNode] = {
    EntryKind.TOPIC: ros.Topic,
    EntryKind.SERVICE: ros.Service,
    EntryKind.ACTION: ros.Action,
    EntryKind.PARAMETER: ros.Parameter,
    EntryKind.NODE: ros.Node,
    EntryKind.QUERY: ros.Query,
    EntryKind.FAULT: ros.Fault,
}
_KEPT = frozenset({EntryKind.QUERY, EntryKind.MAPPING, EntryKind.DOCUMENT, EntryKind.FAULT})
"""Kinds of entries with a path instead of a ROS name."""
NOTHING_AT_HAND = LatestValue(None)
_MAX_ABOUT = 1000
"""Maximum size in bytes of what there is instead, if nothing is found."""
_RESULTS: JsonSchema = json_object(
    {
        "query": TEXT,
        "total": {"type": "integer"},
        "results": {
            "type": "array",
            "maxItems": MAX_RESULTS,
            "items": json_object(
                {
                    "kind": {"type": "string", "enum": list[Json](kind.value for kind in EntryKind)},
                    "url": URI,
                    "match": {"type": "string", "enum": list[Json](sorted({match.label for match in Match}))},
                },
                {
                    "name": TEXT,
                    "type": {"anyOf": [TEXT, json_array(TEXT)]},
                    "field": TEXT,
                    "value": {},
                    "rate": NUMBER,
                    "resource": URI,
                    "offer": URI,
                },
            ),
        },
    },
    {
        "template": TEXT,
        "matched": {"type": "string", "enum": ["all", "some"]},
        "about": json_array(json_object({"concept": TEXT, "url": URI})),
    },
)


class SearchEngine(Protocol):
    """The search of a robot, or of several."""

    async def find(self, query: Query, permissions: Permissions, limit: int) -> SearchResults:
        """Return at most `limit` readable entries that match, best first."""
        ...


class FindResource(SessionResource):
    """The search, or what one search found for one agent."""

    kind = title = "Search"
    shape = "Source"
    item = PathItem("The search", plain=_RESULTS, query=(_QUERY, _VALUES, FORMAT))
    _text = ""
    _subscribes = False
    links = (RESOURCE, RDF_SOURCE)
    path = "find"
    _results: Sequence[SearchResult] = ()
    _about: Mapping[str, str] = {}
    _pictures: Mapping[str, Thumbnail] = {}
    _found = SearchResults((), 0)

    def __init__(self, services: Services, finder: SearchEngine) -> None:
        super().__init__(services)
        self.finder = finder

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the search for `?q=` with the agent's permissions. Raises a 400 Problem for too many words."""
        query = " ".join(exchange.query.get("q", "").split())
        try:
            read_query(query, PHRASES)
        except ValueError as error:
            raise Problem(400, f"?q= is too long: {error}. Send fewer.") from error
        subscribes = exchange.query_flag("values")
        found = self.variant(_text=query, _permissions=exchange.permissions, _subscribes=subscribes)
        if query:
            found.url = f"{self.url}?q={quote(query, safe='')}{'&values=true' if subscribes else ''}"
            found.shape, found.title = "SearchResults", query
        return found

    async def state(self) -> State:
        if not self._text:
            return State(self.document, self._plain)
        self._found = await self.finder.find(read_query(self._text, PHRASES), self._permissions, MAX_RESULTS)
        self._results = await self._results_of(self._found.hits)
        self._about = self._about_robot()
        plain = self._plain()
        results = SearchOutline(self._found.total, self._found.is_complete, self._results, self._about)
        describe = partial(search_document, self.url, self._text, results, self.space)
        return State(describe, lambda: plain, digest(plain))

    def document(self) -> Document:
        """Return the description of the search without results."""
        return unasked_document(self.url, self.space)

    def _about_robot(self) -> dict[str, str]:
        """Return the URL of the best entry for each concept that the robot has, as many as fit."""
        found, room = dict[str, str](), _MAX_ABOUT
        for concept, entry in self._found.concepts:
            room -= len(orjson.dumps({"concept": concept, "url": entry.url})) + 1
            if room > 0:
                found[concept] = entry.url
        return found

    async def _results_of(self, hits: Sequence[Hit]) -> Sequence[SearchResult]:
        """Return the results, each with its latest value if available."""
        values = await self.values([hit.entry for hit in hits])
        small = {url: thumbnail(latest, url) for url, latest in values.items()}
        self._pictures = {url: picture for url, picture in small.items() if picture is not None}
        return [self._result(hit, values.get(hit.entry.url, NOTHING_AT_HAND)) for hit in hits]

    def _result(self, hit: Hit, latest: LatestValue) -> SearchResult:
        entry = hit.entry
        name = None if entry.kind in _KEPT else entry.name
        member = MemberOutline(entry.url, _CLASSES.get(entry.kind), name, entry.types, latest.rate, latest.json)
        resource = entry.resource if entry.resource and self._permissions.may_read(entry.resource) else None
        offer = offer_url(entry.url) if entry.is_writable else None
        return SearchResult(member, entry.kind.value, hit.match.label, hit.field, resource, offer)

    async def values(self, entries: Sequence[Entry]) -> Mapping[str, LatestValue]:
        """Return the latest values by URL: of subscribed topics, of parameters, and cached ones of getters."""
        found = dict[str, LatestValue]()
        if self._subscribes:
            await self._subscribe([entry.name for entry in entries if entry.kind is EntryKind.TOPIC])
        tree = await self.services.affordances.tree()
        stored: dict[str, Property] = {}
        for entry in entries:
            if entry.kind is EntryKind.TOPIC:
                latest = self.services.latest_values.of_topic(entry.name)
                if latest is not None:
                    found[entry.url] = latest
            elif entry.kind is EntryKind.PARAMETER:
                own = tree.catalogue.properties.get(tree.catalogue.by_parameter.get(entry.name, ""))
                if own is not None and isinstance(own.readers[0], ParameterSource):
                    stored[entry.url] = own
            elif entry.kind is EntryKind.RESOURCE:
                plan = tree.property(entry.name)
                if plan is not None and not any(isinstance(one, TopicSource) for one in plan.source.readers):
                    found |= _read(entry.url, self.services.property_reader.cached(plan.source))
        deadline = loop_time() + _PARAMETER_SECONDS
        readings = await self.services.property_reader.read([*stored.values()], deadline=deadline) if stored else {}
        for url, own in stored.items():
            found |= _read(url, readings[own.name])
        return found

    async def _subscribe(self, names: Sequence[str]) -> None:
        """Read topics with small messages; they stay subscribed as after any read."""
        topics, light = self.session.graph.topics, list[str]()
        for name in names:
            ref = topics[name].type if name in topics else None
            with suppress(RosError):
                if ref is not None and is_light(await self.session.schemas.message(ref)):
                    light.append(name)
        await asyncio.gather(*map(self.session.topics.read, light), return_exceptions=True)

    def _plain(self) -> bytes:
        """Return the results as plain JSON: as many as fit, then as many values as fit."""
        head: dict[str, object] = {"query": self._text, "total": self._found.total}
        if not self._text:
            return orjson.dumps({**head, "template": search_template(self.space), "results": []})
        if self._results:
            head["matched"] = "all" if self._found.is_complete else "some"
        else:
            head["about"] = [{"concept": concept, "url": url} for concept, url in self._about.items()]
        room = MAX_BYTES - len(orjson.dumps({**head, "results": []}))
        texts = [_json(result, value=False) for result in self._results]
        while sum(map(len, texts)) + len(texts) > room:
            texts.pop()
        room -= sum(map(len, texts)) + len(texts)
        for number, result in enumerate(self._results[: len(texts)]):
            text = _json(result)
            room -= len(text) - len(texts[number])
            if room < 0:
                break
            texts[number] = text
        return orjson.dumps({**head, "results": list(map(orjson.Fragment, texts))})

    def page(self, site: Site, state: State, forms: Sequence[Form], csrf: Csrf, notices: Sequence[Notice]) -> bytes:
        url = self.url if self._text else f"{self.space.base}find"
        found, total, complete = tuple(self._results), self._found.total, self._found.is_complete
        page = SearchPage(site, url, self._text, found, total, complete, self._about, tuple(notices), self._pictures)
        return render_search(page)

    @property
    def query(self) -> str:
        return self.url.partition("?")[2]


def _read(url: str, reading: Reading | None) -> dict[str, LatestValue]:
    """Return the value of a reading by URL; empty if there is none."""
    if reading is None or reading.value is None:
        return {}
    try:
        return {url: LatestValue(brief_json(reading.value))}
    except ValueError:  # nested too deep
        return {}


def _json(result: SearchResult, *, value: bool = True) -> bytes:
    """Return a result as plain JSON."""
    member = result.member
    members: dict[str, object] = {
        "name": member.name,
        "kind": result.kind,
        "type": member.types[0] if len(member.types) == 1 else list(member.types) or None,
        "url": member.url,
        "match": result.match,
        "field": result.field,
        "value": orjson.Fragment(member.value) if value and member.value is not None else None,
        "rate": member.rate,
        "resource": result.resource,
        "offer": result.offer,
    }
    return orjson.dumps({name: each for name, each in members.items() if each is not None})
