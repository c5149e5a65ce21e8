"""The search index: entries, their matches by words and by meaning, and the ranking of matches."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from enum import Enum, IntEnum
from heapq import nsmallest
from itertools import islice
from typing import NamedTuple, TypeAlias

from msgspec import Struct

from rosld.server.search.thesaurus import CONCEPTS, KNOWN, MARKS, WORDS, Concept, concepts_of_type, marked_concepts
from rosld.server.search.words import MIN_CORRECTED, Query, corrections, stem, words_of


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
    FAULT = "fault"


class Entry(Struct, frozen=True):
    """A search entry for a resource with a URL.

    `name` is a ROS name, or the path of a stored document. `types` are the names of its ROS types, usually one. `texts`
    are titles, descriptions and units. `resource` is the URL of the equivalent resource below `/resources/`.
    `is_writable` is whether it can be written to or invoked, `is_internal` whether ROS gives every node such a name.
    """

    kind: EntryKind
    name: str
    url: str
    types: tuple[str, ...] = ()
    texts: tuple[str, ...] = ()
    resource: str | None = None
    is_writable: bool = False
    is_internal: bool = False


class Catalog(Struct, frozen=True):
    """All entries, and the field paths of their types (`pose.position.x`) by type name."""

    entries: Sequence[Entry]
    fields: Mapping[str, Sequence[str]] = {}


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
    TYPE_MEANING = 5
    NAME_MEANING = 6
    WORD_PREFIX = 7
    TEXT = 8
    PART = 9
    FIELD_MEANING = 10
    FIELD = 11
    FIELD_PREFIX = 12
    TYPE = 13
    TYPE_PREFIX = 14

    @property
    def label(self) -> str:
        """Label for clients: `name`, `prefix`, `word`, `meaning`, `text`, `part`, `field` or `type`."""
        return _LABELS[self]


_LABELS = {
    Match.NAME: "name", Match.SEGMENT: "name", Match.NAME_PREFIX: "prefix", Match.SEGMENT_PREFIX: "prefix",
    Match.WORD: "word", Match.WORD_PREFIX: "word", Match.TEXT: "text", Match.PART: "part", Match.FIELD: "field",
    Match.FIELD_PREFIX: "field", Match.TYPE: "type", Match.TYPE_PREFIX: "type", Match.TYPE_MEANING: "meaning",
    Match.NAME_MEANING: "meaning", Match.FIELD_MEANING: "meaning",
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
_MEANING = dict.fromkeys(_Place, Match.NAME_MEANING) | {_Place.TEXT: Match.TEXT}


Rank: TypeAlias = tuple[int, int, int, int, str]
"""Sort key of hits: quality of the match, kind, depth and length of the name, and the name."""


class Hit(NamedTuple):
    """A matching entry: the match of its worst term, and the field that matched that term, if any."""

    rank: Rank
    entry: Entry
    match: Match
    field: str | None


class SearchResults(NamedTuple):
    """The best matching entries, the number of all, and whether they match all terms of the query.

    `concepts` are what the robot has instead if nothing matches, each with the best entry for it.
    """

    hits: Sequence[Hit]
    total: int
    is_complete: bool = True
    concepts: Sequence[tuple[str, Entry]] = ()

    @classmethod
    def merge(cls, found: Sequence[SearchResults], query: Query, limit: int) -> SearchResults:
        """Return the best of the results that several indexes have for a query."""
        complete = [each for each in found if each.hits and each.is_complete]
        best = complete if complete and query.commands is None else found
        hits = sorted((hit for each in best for hit in each.hits), key=lambda hit: hit.rank)
        concepts = [] if hits else [concept for each in found for concept in each.concepts]
        return cls(hits[:limit], sum(each.total for each in best), all(each.is_complete for each in best), concepts)


_Fits: TypeAlias = dict[int, Match]
"""Matches of a term, by the numbers of entries."""


_READ_AND_WRITTEN = (EntryKind.PARAMETER, EntryKind.RESOURCE)
"""Kinds of entries that tell something even if they can be written to."""
_ENOUGH = 3
"""Number of matches of all words of a question below which matches of some follow: `is the battery low`."""
_CONTRARY = 5
"""Points of an entry that reports where the query commands, or commands where it asks."""
_INTERNAL = 20
"""Points of what ROS gives every node, and of nodes, unless their own name is asked for."""
_MAX_BEST = 10
"""Maximum number of entries that are tried as the best for a concept: the first may not be readable."""
_MISSING = 1000
"""Points of a term that does not match."""


class SearchIndex:
    """Index of the entries of one catalog by their words; built once, searched often.

    Entries are numbered in tie-breaking order, so that thousands of matches are sorted by two integers.
    """

    def __init__(self, catalog: Catalog, *, by_meaning: bool = True) -> None:
        self._by_meaning = by_meaning
        self._entries = sorted(catalog.entries, key=_tie)
        self._names = [entry.name.casefold() for entry in self._entries]
        self._places: dict[str, dict[int, _Place]] = {}
        for number, entry in enumerate(self._entries):
            for word, place in _places(entry):
                known = self._places.setdefault(word, {})
                known[number] = min(place, known.get(number, place))
        self._ordered = sorted(self._places)
        self._stems: dict[str, list[str]] = {}
        for word in self._ordered:
            self._stems.setdefault(stem(word), []).append(word)
        self._fields = {name: tuple(fields) for name, fields in catalog.fields.items()}
        self._by_type: dict[str, list[int]] = {}
        for number, entry in enumerate(self._entries):
            for name in entry.types:
                self._by_type.setdefault(name, []).append(number)
        self._marked = {name: marked_concepts(map(_own_name, (name, *self._paths(name)))) for name in self._by_type}
        self._carriers: dict[str, _Fits] = {}
        self._best: dict[str, list[Entry]] | None = None
        commands = [entry.is_writable or any(map(_is_command, entry.types)) for entry in self._entries]
        asked = {n for n, each in enumerate(self._entries) if commands[n] and each.kind not in _READ_AND_WRITTEN}
        self._contrary = {True: {n for n, each in enumerate(commands) if not each}, False: asked, None: set[int]()}
        self._internal = {number for number, entry in enumerate(self._entries) if entry.is_internal}

    def find(self, query: Query, limit: int, may_read: Callable[[str], bool] | None = None) -> SearchResults:
        """Return the entries that match all terms, or as many as possible, and may be read, at most `limit` of them.

        The best come first: those that do what the query commands, or tell what it asks, then the names of others.
        """
        fits = [self._fits(term) for term in query.terms]
        whole = self._readable(set(fits[0]).intersection(*fits[1:]) if fits else (), may_read)
        certain = (number for number in whole if len(fits) == 1 or _is_certain(number, fits))
        enough = 1 if query.commands is None or len(fits) == 1 else _ENOUGH
        has_enough = len(list(islice(certain, enough))) == enough
        shared = whole if has_enough else self._readable(set[int]().union(*fits), may_read)
        points = {number: sum(fit.get(number, _MISSING) for fit in fits) for number in shared}
        for number in self._contrary[query.commands] & points.keys():
            points[number] += _CONTRARY
        for number in self._internal & points.keys():
            matches = [fit[number] for fit in fits if number in fit]
            points[number] += _INTERNAL if max(matches) > Match.NAME and min(matches) != Match.TYPE_MEANING else 0
        for word in query.dropped:
            places = self._places.get(word, {})
            for number in places.keys() & points.keys():
                points[number] -= places[number] != _Place.TEXT
        best = nsmallest(limit, ((each, number) for number, each in points.items()))
        hits = [self._hit(number, each, query.terms, fits) for each, number in best]
        return SearchResults(hits, len(shared), len(shared) == len(whole), () if hits else self._concepts(may_read))

    def _concepts(self, may_read: Callable[[str], bool] | None) -> list[tuple[str, Entry]]:
        """Return the best entry for each concept, if there is one that may be read."""
        if self._best is None:
            self._best = {}
            for concept in CONCEPTS:
                fits, others = self._carriers_of(concept), self._internal | self._contrary[concept.commands]
                best = nsmallest(_MAX_BEST, ((fits[number], number) for number in fits if number not in others))
                self._best[concept.name] = [self._entries[number] for _, number in best]
        readable = {name: [e for e in each if may_read is None or may_read(e.url)] for name, each in self._best.items()}
        return [(name, entries[0]) for name, entries in readable.items() if entries]

    def _readable(self, numbers: Iterable[int], may_read: Callable[[str], bool] | None) -> set[int]:
        return {number for number in numbers if may_read is None or may_read(self._entries[number].url)}

    def _paths(self, type: str) -> Sequence[str]:
        return self._fields.get(type, ())

    def _hit(self, number: int, points: int, terms: Sequence[str], fits: Sequence[_Fits]) -> Hit:
        entry = self._entries[number]
        match, term = max((fit[number], term) for fit, term in zip(fits, terms, strict=True) if number in fit)
        if match.label not in ("field", "meaning"):
            return Hit((points, *_tie(entry)), entry, match, None)
        found = [self._type_fit(name, term) for name in entry.types]
        exact, path = min(((one, path) for one, path in found if one is not None), default=(match, None))
        if match == exact == Match.FIELD_MEANING:
            path = self._meant_field(entry, term)
        return Hit((points, *_tie(entry)), entry, exact, path)

    def _meant_field(self, entry: Entry, term: str) -> str | None:
        """Return the path of a field that means the same as a term, or None."""
        concepts = {*WORDS.get(stem(term), ())}
        paths = (path for name in entry.types for path in self._paths(name))
        return next((path for path in paths if not concepts.isdisjoint(marked_concepts([_own_name(path)]))), None)

    def _fits(self, term: str) -> _Fits:
        """Return the best match of a term in each entry, with a typing error corrected if there is none."""
        found = self._known_fits(term)
        if found or len(term) < MIN_CORRECTED:
            return found
        return _best({}, *map(self._known_fits, corrections(term, KNOWN, self._places)))

    def _known_fits(self, term: str) -> _Fits:
        """Return the best match of a term in each entry: of itself, of what it means, or of its stem."""
        direct, root = self._direct_fits(term), stem(term)
        others = [self._carriers_of(concept) for concept in WORDS.get(root, ()) if self._by_meaning]
        if not direct:
            others += [_at(self._places[word], _EXACT) for word in self._stems.get(root, ())]
        return _best(direct, *others)

    def _carriers_of(self, concept: Concept) -> _Fits:
        """Return the matches of a concept, by types, by the words of names, and by the words of fields."""
        found = self._carriers.get(concept.name)
        if found is None:
            typed = [name for name in self._by_type if concept in concepts_of_type(name)]
            marked = [name for name, concepts in self._marked.items() if concept in concepts]
            words = [
                word for root, concepts in MARKS.items() if concept in concepts for word in self._stems.get(root, ())
            ]
            found = self._carriers[concept.name] = _best(
                {},
                *(dict.fromkeys(self._by_type[name], Match.TYPE_MEANING) for name in typed),
                *(dict.fromkeys(self._by_type[name], Match.FIELD_MEANING) for name in marked),
                *(_at(self._places[word], _MEANING) for word in words),
            )
        return found

    def _direct_fits(self, term: str) -> _Fits:
        """Return the best match of a term in each entry; a term of several words (`image_raw`) needs all of them."""
        if "/" in term:
            return self._path_fits(term)
        found = self._word_fits(term)
        parts = words_of(term)
        if found or len(parts) < 2:
            return found
        each = [self._direct_fits(part) for part in parts]
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
        for path in self._paths(name):
            own = _own_name(path).casefold()
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


def _at(places: Mapping[int, _Place], matches: Mapping[_Place, Match]) -> _Fits:
    return {number: matches[place] for number, place in places.items()}


def _best(first: _Fits, *others: _Fits) -> _Fits:
    """Return the best match of each entry; `first` itself if there are no others."""
    others = tuple(filter(None, others))
    if not others:
        return first
    found = dict(first)
    for fits in others:
        for number, match in fits.items():
            if number not in found or match < found[number]:
                found[number] = match
    return found


def _is_certain(number: int, fits: Sequence[_Fits]) -> bool:
    """Whether an entry matches all terms by more than fields that may mean them."""
    return all(fit[number] != Match.FIELD_MEANING for fit in fits)


def _own_name(path: str) -> str:
    """Return the last part of the name of a type, or of the path of a field."""
    return path.rpartition("/")[2].rpartition(".")[2].removesuffix("[]")


def _is_command(type: str) -> bool:
    concepts = concepts_of_type(type)
    return bool(concepts) and all(concept.commands for concept in concepts)


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
