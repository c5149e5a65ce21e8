"""The search index: words, the ranking of matches, and the entries of a robot's graph and resources."""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import Enum, IntEnum
from functools import lru_cache
from heapq import nsmallest
from typing import NamedTuple, TypeAlias

from msgspec import Struct

from rosld.adapters.model import (
    Array,
    Descriptor,
    FieldType,
    Graph,
    MessageSchema,
    Nested,
    Primitive,
    Schema,
    TypeRef,
    halves_of,
)
from rosld.ontology.urls import Space
from rosld.server.hypermedia.conditions import url_of
from rosld.server.hypermedia.mapping import ComplexResource
from rosld.server.hypermedia.resource_tree import ResourceTree


class EntryKind(Enum):
    """Kind of an entry; among equal matches, earlier kinds rank higher."""

    ACTION = "action"
    TOPIC = "topic"
    SERVICE = "service"
    RESOURCE = "resource"
    PARAMETER = "parameter"
    NODE = "node"
    QUERY = "query"
    MAPPING = "mapping"
    DOCUMENT = "document"


class Entry(Struct, frozen=True):
    """A search entry for a resource with a URL.

    `name` is a ROS name, or the path of a stored document. `types` are the names of its ROS types, usually one. `texts`
    are titles, descriptions and units. `resource` is the URL of the equivalent resource below `/resources/`.
    """

    kind: EntryKind
    name: str
    url: str
    types: tuple[str, ...] = ()
    texts: tuple[str, ...] = ()
    resource: str | None = None


class Catalog(Struct, frozen=True):
    """All entries, and the field paths of their types (`pose.position.x`) by type name."""

    entries: Sequence[Entry]
    fields: Mapping[str, Sequence[str]] = {}


_RUN = re.compile(r"[^\W\d_]+|\d+")


@lru_cache(maxsize=16384)
def words_of(text: str) -> tuple[str, ...]:
    """Return the words of a name or a sentence, in lower case, each once.

    `image_raw`, `BatteryState`, `IMUData` and `scan2` have two words each.
    """
    return tuple(dict.fromkeys(word.casefold() for run in _RUN.findall(text) for word in _humps(run)))


def _humps(run: str) -> Iterator[str]:
    """Yield the words of a run of letters: one begins with a capital after a lower-case letter, or before one."""
    start = 0
    for index in range(1, len(run)):
        is_last_capital = run[index - 1].isupper() and run[index : index + 2].istitle() and len(run) > index + 1
        if run[index].isupper() and (run[index - 1].islower() or is_last_capital):
            yield run[start:index]
            start = index
    yield run[start:]


MAX_WORDS = 8
MAX_CHARACTERS = 200
"""Maximum numbers of words and characters of a query; `terms_of` rejects more."""
_MIN_PART = 3
"""Minimum number of characters of a term that is searched within words."""
_KIND_ORDER = {kind: order for order, kind in enumerate(EntryKind)}


class Match(IntEnum):
    """Kind of match of a word, the best first; `label` is for clients."""

    NAME = 0
    SEGMENT = 1
    NAME_PREFIX = 2
    SEGMENT_PREFIX = 3
    WORD = 4
    WORD_PREFIX = 5
    TEXT = 6
    PART = 7
    FIELD = 8
    FIELD_PREFIX = 9
    TYPE = 10
    TYPE_PREFIX = 11

    @property
    def label(self) -> str:
        """Label for clients: `name`, `prefix`, `word`, `text`, `part`, `field` or `type`."""
        return _LABELS[self]


_LABELS = {
    Match.NAME: "name", Match.SEGMENT: "name", Match.NAME_PREFIX: "prefix", Match.SEGMENT_PREFIX: "prefix",
    Match.WORD: "word", Match.WORD_PREFIX: "word", Match.TEXT: "text", Match.PART: "part", Match.FIELD: "field",
    Match.FIELD_PREFIX: "field", Match.TYPE: "type", Match.TYPE_PREFIX: "type",
}  # fmt: skip


class _Place(IntEnum):
    """Place of a word in an entry or a type."""

    LAST_SEGMENT = 0
    SEGMENT = 1
    WORD = 2
    TEXT = 3


_EXACT = {
    _Place.LAST_SEGMENT: Match.NAME, _Place.SEGMENT: Match.SEGMENT, _Place.WORD: Match.WORD, _Place.TEXT: Match.TEXT,
}  # fmt: skip
_PREFIX = {
    _Place.LAST_SEGMENT: Match.NAME_PREFIX, _Place.SEGMENT: Match.SEGMENT_PREFIX, _Place.WORD: Match.WORD_PREFIX,
    _Place.TEXT: Match.TEXT,
}  # fmt: skip


Rank: TypeAlias = tuple[int, int, int, int, str]
"""Sort key of hits: quality of the match, kind, depth and length of the name, and the name."""


class Hit(NamedTuple):
    """A matching entry: the match of its worst term, and the field that matched that term, if any."""

    rank: Rank
    entry: Entry
    match: Match
    field: str | None


class SearchResults(NamedTuple):
    """The best matching entries, and the number of all."""

    hits: list[Hit]
    total: int


_Fits: TypeAlias = dict[int, Match]
"""Matches of a term, by the numbers of entries."""


def terms_of(query: str) -> tuple[str, ...]:
    """Return the terms of a query. Raises ValueError if there are too many."""
    if len(query) > MAX_CHARACTERS:
        raise ValueError(f"it has {len(query)} characters, but the limit is {MAX_CHARACTERS}")
    terms = tuple(dict.fromkeys(query.casefold().split()))
    if len(terms) > MAX_WORDS:
        raise ValueError(f"it has {len(terms)} words, but the limit is {MAX_WORDS}")
    return terms


class SearchIndex:
    """Index of the entries of one catalog by their words; built once, searched often.

    Entries are numbered in tie-breaking order, so that thousands of matches are sorted by two integers.
    """

    def __init__(self, catalog: Catalog) -> None:
        self._entries = sorted(catalog.entries, key=_tie)
        self._names = [entry.name.casefold() for entry in self._entries]
        self._places: dict[str, dict[int, _Place]] = {}
        for number, entry in enumerate(self._entries):
            for word, place in _places(entry):
                known = self._places.setdefault(word, {})
                known[number] = min(place, known.get(number, place))
        self._ordered = sorted(self._places)
        self._fields = {name: tuple(fields) for name, fields in catalog.fields.items()}
        self._by_type: dict[str, list[int]] = {}
        for number, entry in enumerate(self._entries):
            for name in entry.types:
                self._by_type.setdefault(name, []).append(number)

    def find(self, terms: Sequence[str], limit: int, may_read: Callable[[str], bool] | None = None) -> SearchResults:
        """Return the entries that match all terms and may be read, best first, at most `limit` of them."""
        fits = [self._fits(term) for term in terms]
        shared = set(fits[0]).intersection(*fits[1:]) if fits else set[int]()
        if may_read is not None:
            shared = {number for number in shared if may_read(self._entries[number].url)}
        best = nsmallest(limit, ((sum(fit[number] for fit in fits), number) for number in shared))
        return SearchResults([self._hit(number, points, terms, fits) for points, number in best], len(shared))

    def _hit(self, number: int, points: int, terms: Sequence[str], fits: Sequence[_Fits]) -> Hit:
        entry = self._entries[number]
        match, term = max((fit[number], term) for fit, term in zip(fits, terms, strict=True))
        field = self._field(entry, term) if match in (Match.FIELD, Match.FIELD_PREFIX) else None
        return Hit((points, *_tie(entry)), entry, match, field)

    def _field(self, entry: Entry, term: str) -> str | None:
        found = (self._type_fit(name, term) for name in entry.types)
        return next((path for match, path in found if match in (Match.FIELD, Match.FIELD_PREFIX)), None)

    def _fits(self, term: str) -> _Fits:
        """Return the best match of a term in each entry; a term of several words (`image_raw`) needs all of them."""
        if "/" in term:
            return self._path_fits(term)
        found = self._word_fits(term)
        parts = words_of(term)
        if found or len(parts) < 2:
            return found
        each = [self._fits(part) for part in parts]
        return {number: max(fits[number] for fits in each) for number in set(each[0]).intersection(*each[1:])}

    def _word_fits(self, term: str) -> _Fits:
        """Return the matches of a single word; better ones are found later and replace the earlier ones."""
        found: _Fits = {}
        for name, numbers in self._by_type.items():
            match, _ = self._type_fit(name, term)
            if match is not None:
                found |= {number: match for number in numbers if number not in found or match < found[number]}
        if len(term) >= _MIN_PART:
            found |= {number: Match.PART for number, name in enumerate(self._names) if term in name}
        for word in self._beginning(term):
            matches = _EXACT if word == term else _PREFIX
            for number, place in self._places[word].items():
                match = matches[place]
                if number not in found or match < found[number]:
                    found[number] = match
        return found

    def _beginning(self, term: str) -> Iterator[str]:
        """Yield the indexed words that start with a term, including the term itself."""
        for index in range(bisect_left(self._ordered, term), len(self._ordered)):
            if not self._ordered[index].startswith(term):
                return
            yield self._ordered[index]

    def _path_fits(self, term: str) -> _Fits:
        """Return the matches of a term with a slash, which is a part of a full name or of a type."""
        found: _Fits = {}
        for name, numbers in self._by_type.items():
            if name.casefold().startswith(term):
                found |= dict.fromkeys(numbers, Match.TYPE if name.casefold() == term else Match.TYPE_PREFIX)
        for number, name in enumerate(self._names):
            if term in name:
                is_prefix = Match.NAME_PREFIX if name.startswith(term) else Match.PART
                found[number] = Match.NAME if name == term else is_prefix
        return found

    def _type_fit(self, name: str, term: str) -> tuple[Match | None, str | None]:
        """Return the match of a term in a type: a field's name (with its path), else a word of the type's name."""
        prefix: str | None = None
        for path in self._fields.get(name, ()):
            own = path.rpartition(".")[2].removesuffix("[]").casefold()
            words = words_of(own)
            if own == term or term in words:
                return Match.FIELD, path
            if prefix is None and (own.startswith(term) or any(word.startswith(term) for word in words)):
                prefix = path
        if prefix is not None:
            return Match.FIELD_PREFIX, prefix
        words = words_of(name)
        if term in words or name.rpartition("/")[2].casefold() == term:
            return Match.TYPE, None
        return (Match.TYPE_PREFIX, None) if any(word.startswith(term) for word in words) else (None, None)


def _tie(entry: Entry) -> tuple[int, int, int, str]:
    return _KIND_ORDER[entry.kind], entry.name.count("/"), len(entry.name), entry.name


def _places(entry: Entry) -> Iterator[tuple[str, _Place]]:
    segments = [segment for segment in entry.name.split("/") if segment]
    for segment in segments:
        yield segment.casefold(), _Place.LAST_SEGMENT if segment is segments[-1] else _Place.SEGMENT
        for word in words_of(segment):
            yield word, _Place.WORD
    for text in entry.texts:
        for word in words_of(text):
            yield word, _Place.TEXT


_MAX_FIELDS = 400
"""Maximum number of indexed fields of a type."""
_MAX_DEPTH = 8
STOP_TEXT = "Stop the whole robot: emergency stop, halt"


def catalog_of(
    graph: Graph, find_schema: Callable[[TypeRef], Schema | None], tree: ResourceTree, space: Space
) -> Catalog:
    """Return the catalog of a graph and its resources, with the fields of cached types."""
    found = [*_graph_entries(graph, tree, space), *_resource_entries(graph, tree, space)]
    refs = {ref for topic in graph.topics.values() for ref in topic.types}
    refs |= {service.type for service in graph.services.values() if service.type is not None}
    refs |= {action.type for action in graph.actions.values() if action.type is not None}
    schemas = {ref.name: schema for ref in refs if (schema := find_schema(ref)) is not None}
    return Catalog(tuple(found), {name: field_paths(schema) for name, schema in schemas.items()})


def field_paths(schema: Schema) -> tuple[str, ...]:
    """Return the field paths of a type (`pose.position.x`, `status[].level`); of a service those of both messages."""
    found: list[str] = []
    for half in halves_of(schema):
        for path in _paths(half, Nested(half.ref.name), "", 0):
            found.append(path)
            if len(found) == _MAX_FIELDS:
                return tuple(found)
    return tuple(dict.fromkeys(found))


def _paths(schema: MessageSchema, kind: FieldType, prefix: str, depth: int) -> Iterator[str]:
    """Yield the fields of a type before those of its fields, so that the shortest path of a name comes first."""
    if isinstance(kind, Array):
        kind, prefix = kind.element, f"{prefix}[]"
    if isinstance(kind, Primitive) or depth > _MAX_DEPTH:
        return
    start = f"{prefix}." if prefix else ""
    fields = schema.types[kind.name].fields
    yield from (start + field.name for field in fields)
    for field in fields:
        yield from _paths(schema, field.type, start + field.name, depth + 1)


def _graph_entries(graph: Graph, tree: ResourceTree, space: Space) -> Iterator[Entry]:
    """Yield the entries of names in the graph, each with a resource of the same name."""
    properties, actions = set(tree.properties), set(tree.actions)

    def resource(name: str, among: set[str]) -> str | None:
        return url_of(name, space) if name in among else None

    for name, topic in graph.topics.items():
        types = tuple(ref.name for ref in topic.types)
        own = resource(name, properties)
        yield Entry(EntryKind.TOPIC, name, space.topic(name), types, _property_texts(tree, name, own), own)
    for name, service in graph.services.items():
        types = () if service.type is None else (service.type.name,)
        yield Entry(EntryKind.SERVICE, name, space.service(name), types, (), resource(name, actions))
    for name, action in graph.actions.items():
        types = () if action.type is None else (action.type.name,)
        yield Entry(EntryKind.ACTION, name, space.action(name), types, (), resource(name, actions))
    for name, parameter in graph.parameters.items():
        own = resource(name, properties) if name not in graph.topics else None
        texts = (*_property_texts(tree, name, own), *_declared_texts(parameter.descriptor))
        yield Entry(EntryKind.PARAMETER, name, space.parameter(name), (), texts, own)
    for name in graph.nodes:
        yield Entry(EntryKind.NODE, name, space.node(name))


def _resource_entries(graph: Graph, tree: ResourceTree, space: Space) -> Iterator[Entry]:
    """Yield the resources without a name in the graph: properties of getters and setters, mapped ones, and paths."""
    yield Entry(EntryKind.RESOURCE, "/stop", space.stop, (), (STOP_TEXT,))
    for name in tree.properties:
        if name not in graph.topics and name not in graph.parameters:
            url = url_of(name, space)
            yield Entry(EntryKind.RESOURCE, name, url, (), _property_texts(tree, name, url))
    for name in tree.actions:
        if name not in graph.services and name not in graph.actions:
            yield Entry(EntryKind.RESOURCE, name, url_of(name, space))
    for path in tree.paths:
        if path != "/":
            mapped = tree.mapping_set.resources.get(path)
            yield Entry(EntryKind.RESOURCE, path, url_of(path, space), (), _complex_texts(mapped))


def _complex_texts(mapped: ComplexResource | None) -> tuple[str, ...]:
    return () if mapped is None or mapped.title is None else (mapped.title,)


def _property_texts(tree: ResourceTree, name: str, url: str | None) -> tuple[str, ...]:
    """Return the texts of a mapping about a property: its relation, unit, and kind of quantity."""
    plan = None if url is None else tree.property(name)
    mapped = None if plan is None else plan.mapped
    if mapped is None:
        return ()
    terms = (mapped.predicate, mapped.measure.unit, mapped.measure.quantity_kind)
    return (mapped.name, *(local_name(term.value) for term in terms if term is not None))


def _declared_texts(descriptor: Descriptor | None) -> Sequence[str]:
    return () if descriptor is None else tuple(filter(None, (descriptor.description, descriptor.constraints)))


def local_name(iri: str) -> str:
    """Return the local name of an IRI: `M-PER-SEC` for QUDT's metres per second."""
    return iri.rstrip("/#").rpartition("#")[2].rpartition("/")[2]
