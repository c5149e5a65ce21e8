"""Search at `/find?q=battery`: everything of the robot that matches the words (schema:ItemList, hydra:search)."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from urllib.parse import quote

import orjson
from pyoxigraph import NamedNode

from rosld.adapters.model import RosError
from rosld.ontology.describe_views import (
    MemberOutline,
    SearchResult,
    search_document,
    search_template,
    unasked_document,
)
from rosld.ontology.document import Document
from rosld.ontology.vocab import ros
from rosld.server.html.forms import Form
from rosld.server.html.page import Csrf, Notice, SearchPage, Thumbnail
from rosld.server.html.render import render_search
from rosld.server.html.site import Site
from rosld.server.http.conditional import digest
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.affordance_service import AffordanceService
from rosld.server.hypermedia.brief_value import LatestValue, LatestValues, brief_json
from rosld.server.hypermedia.catalogue import ParameterSource, Property, TopicSource
from rosld.server.hypermedia.json_schema import NUMBER, TEXT, URI, Json, JsonSchema, json_array, json_object
from rosld.server.hypermedia.property_reader import PropertyReader
from rosld.server.hypermedia.type_inference import is_light
from rosld.server.hypermedia.value import Reading
from rosld.server.resources.finder import Finder
from rosld.server.resources.namespaces import thumbnail
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import FORMAT, PathItem, QueryParameter
from rosld.server.rest.resource import RDF_SOURCE, RESOURCE, Resource
from rosld.server.rest.state import State
from rosld.server.robot.session import Session
from rosld.server.runtime.tasks import loop_time
from rosld.server.search.index import Entry, EntryKind, Hit, Match, terms_of

MAX_RESULTS = 20
MAX_BYTES = 5000
"""What is told at the most, of the bytes in JSON: values are left out before results are."""
_PARAMETER_SECONDS = 0.3
"""How long the values of parameters that were found are waited for."""
_QUERY = QueryParameter("q", "Words that are looked for in names, types, their fields, titles, units and descriptions.")
_VALUES = QueryParameter(
    "values",
    "Whether to subscribe for a moment to the topics that are found, but to none of images, clouds, maps and scans.",
    {"type": "boolean"},
)
_CLASSES: Mapping[EntryKind, NamedNode] = {
    EntryKind.TOPIC: ros.Topic,
    EntryKind.SERVICE: ros.Service,
    EntryKind.ACTION: ros.Action,
    EntryKind.PARAMETER: ros.Parameter,
    EntryKind.NODE: ros.Node,
    EntryKind.QUERY: ros.Query,
}
_KEPT = frozenset({EntryKind.QUERY, EntryKind.MAPPING, EntryKind.DOCUMENT})
"""What has a path and no name of ROS."""
NOTHING_AT_HAND = LatestValue(None)
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
                },
            ),
        },
    },
    {"template": TEXT},
)


class FindResource(Resource):
    """The search, or what one search found for one agent."""

    kind = title = "Search"
    shape = "Source"
    item = PathItem("The search", plain=_RESULTS, query=(_QUERY, _VALUES, FORMAT))
    _text = ""
    _subscribes = False
    links = (RESOURCE, RDF_SOURCE)

    def __init__(
        self,
        session: Session,
        affordances: AffordanceService[State],
        latest_values: LatestValues,
        property_reader: PropertyReader,
        finder: Finder,
    ) -> None:
        super().__init__(session.space, f"{session.space.base}find")
        self.session = session
        self.affordances = affordances
        self.latest_values = latest_values
        self.property_reader = property_reader
        self._finder = finder
        self._results: Sequence[SearchResult] = ()
        self._pictures: Mapping[str, Thumbnail] = {}
        self._total = 0

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the search for what `?q=` says, as the agent may see it. Raises a 400 Problem for too many words."""
        query = " ".join(exchange.query.get("q", "").split())
        try:
            terms_of(query)
        except ValueError as error:
            raise Problem(400, f"?q= cannot be searched for: {error}. Send fewer.") from error
        subscribes = exchange.query_flag("values")
        found = self.variant(_text=query, _permissions=exchange.permissions, _subscribes=subscribes)
        if query:
            found.url = f"{self.url}?q={quote(query, safe='')}{'&values=true' if subscribes else ''}"
            found.shape, found.title = "SearchResults", query
        return found

    async def state(self) -> State:
        if not self._text:
            return State(self.document, self._plain)
        hits, self._total = await self._finder.find(terms_of(self._text), self._permissions, MAX_RESULTS)
        self._results = await self._results_of(hits)
        plain = self._plain()
        describe = partial(search_document, self.url, self._text, self._total, self._results, self.space)
        return State(describe, lambda: plain, digest(plain))

    def document(self) -> Document:
        """Return the search itself, while nothing is searched for."""
        return unasked_document(self.url, self.space)

    async def _results_of(self, hits: Sequence[Hit]) -> Sequence[SearchResult]:
        """Return the results, each with its latest value where that is at hand."""
        values = await self._values([hit.entry for hit in hits])
        small = {url: thumbnail(latest, url) for url, latest in values.items()}
        self._pictures = {url: picture for url, picture in small.items() if picture is not None}
        return [self._result(hit, values.get(hit.entry.url, NOTHING_AT_HAND)) for hit in hits]

    def _result(self, hit: Hit, latest: LatestValue) -> SearchResult:
        entry = hit.entry
        name = None if entry.kind in _KEPT else entry.name
        member = MemberOutline(entry.url, _CLASSES.get(entry.kind), name, entry.types, latest.rate, latest.json)
        resource = entry.resource if entry.resource and self._permissions.may_read(entry.resource) else None
        return SearchResult(member, entry.kind.value, hit.match.label, hit.field, resource)

    async def _values(self, entries: Sequence[Entry]) -> Mapping[str, LatestValue]:
        """The latest values by URL: of topics that are subscribed to, of parameters, and of getters that were asked."""
        found = dict[str, LatestValue]()
        if self._subscribes:
            await self._subscribe([entry.name for entry in entries if entry.kind is EntryKind.TOPIC])
        tree = await self.affordances.tree()
        stored: dict[str, Property] = {}
        for entry in entries:
            if entry.kind is EntryKind.TOPIC:
                latest = self.latest_values.of_topic(entry.name)
                if latest is not None:
                    found[entry.url] = latest
            elif entry.kind is EntryKind.PARAMETER:
                own = tree.catalogue.properties.get(tree.catalogue.by_parameter.get(entry.name, ""))
                if own is not None and isinstance(own.readers[0], ParameterSource):
                    stored[entry.url] = own
            elif entry.kind is EntryKind.RESOURCE:
                plan = tree.property(entry.name)
                if plan is not None and not any(isinstance(one, TopicSource) for one in plan.source.readers):
                    found |= _read(entry.url, self.property_reader.cached(plan.source))
        deadline = loop_time() + _PARAMETER_SECONDS
        readings = await self.property_reader.read([*stored.values()], deadline=deadline) if stored else {}
        for url, own in stored.items():
            found |= _read(url, readings[own.name])
        return found

    async def _subscribe(self, names: Sequence[str]) -> None:
        """Look at the topics whose messages are small; they stay subscribed to as after any look."""
        topics, light = self.session.graph.topics, list[str]()
        for name in names:
            ref = topics[name].type if name in topics else None
            with suppress(RosError):
                if ref is not None and is_light(await self.session.schemas.message(ref)):
                    light.append(name)
        await asyncio.gather(*map(self.session.topics.read, light), return_exceptions=True)

    def _plain(self) -> bytes:
        """Return the results as plain JSON: as many as fit, with as many values as fit."""
        head = {"query": self._text, "total": self._total}
        if not self._text:
            return orjson.dumps({**head, "template": search_template(self.space), "results": []})
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
        found = tuple(self._results)
        return render_search(SearchPage(site, url, self._text, found, self._total, tuple(notices), self._pictures))

    @property
    def query(self) -> str:
        return self.url.partition("?")[2]


def _read(url: str, reading: Reading | None) -> dict[str, LatestValue]:
    """The value that was read, by the URL; nothing where there is none."""
    if reading is None or reading.value is None:
        return {}
    try:
        return {url: LatestValue(brief_json(reading.value))}
    except ValueError:  # nested too deep
        return {}


def _json(result: SearchResult, *, value: bool = True) -> bytes:
    """One result as plain JSON."""
    member = result.member
    told: dict[str, object] = {
        "name": member.name,
        "kind": result.kind,
        "type": member.types[0] if len(member.types) == 1 else list(member.types) or None,
        "url": member.url,
        "match": result.match,
        "field": result.field,
        "value": orjson.Fragment(member.value) if value and member.value is not None else None,
        "rate": member.rate,
        "resource": result.resource,
    }
    return orjson.dumps({name: each for name, each in told.items() if each is not None})
