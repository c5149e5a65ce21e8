"""An inverted index of entries: finds those that have all words of a query, the best first. Pure."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple, TypeAlias

from rosld.server.search.entry import Catalog, Entry, EntryKind
from rosld.server.search.words import words_of

MAX_WORDS = 8
MAX_CHARACTERS = 200
"""What a query may have of each; `terms_of` refuses more."""
_MIN_PART = 3
"""Characters from which a term is looked for within words."""
_KIND_ORDER = {kind: order for order, kind in enumerate(EntryKind)}


class Match(IntEnum):
    """How a word of a query fits an entry, the best first: `label` is what clients see."""

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
        """`name`, `prefix`, `word`, `text`, `part`, `field` or `type`."""
        return _LABELS[self]


_LABELS = {
    Match.NAME: "name", Match.SEGMENT: "name", Match.NAME_PREFIX: "prefix", Match.SEGMENT_PREFIX: "prefix",
    Match.WORD: "word", Match.WORD_PREFIX: "word", Match.TEXT: "text", Match.PART: "part", Match.FIELD: "field",
    Match.FIELD_PREFIX: "field", Match.TYPE: "type", Match.TYPE_PREFIX: "type",
}  # fmt: skip


class _Place(IntEnum):
    """Where an entry, or a type, has a word."""

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
"""What hits are ordered by: how well the words fit, the kind, how deep and how long the name is, the name."""


class Hit(NamedTuple):
    """An entry that fits: how the word that fits it worst does, and the field that one was found in, if it was."""

    rank: Rank
    entry: Entry
    match: Match
    field: str | None


class _Fit(NamedTuple):
    match: Match
    field: str | None = None


def terms_of(query: str) -> tuple[str, ...]:
    """The words that a query asks for. Raises ValueError where it has too many, or none."""
    if len(query) > MAX_CHARACTERS:
        raise ValueError(f"it has {len(query)} characters, and {MAX_CHARACTERS} are searched for at the most")
    terms = tuple(dict.fromkeys(query.casefold().split()))
    if len(terms) > MAX_WORDS:
        raise ValueError(f"it has {len(terms)} words, and {MAX_WORDS} are searched for at the most")
    return terms


@dataclass(frozen=True, slots=True)
class _Words:
    """Words in their order, each with where it occurs; a word is found whole, by how it begins and as a part."""

    places: Mapping[str, list[tuple[int, _Place]]]
    ordered: tuple[str, ...]

    def beginning(self, term: str) -> Iterator[str]:
        """The words that begin with a term, itself included."""
        for index in range(bisect_left(self.ordered, term), len(self.ordered)):
            if not self.ordered[index].startswith(term):
                return
            yield self.ordered[index]


class SearchIndex:
    """The entries of one catalog by their words; made once, searched often."""

    def __init__(self, catalog: Catalog) -> None:
        self._entries = tuple(catalog.entries)
        self._names = [entry.name.casefold() for entry in self._entries]
        self._words = _index((number, _places(entry)) for number, entry in enumerate(self._entries))
        self._fields = {name: tuple(fields) for name, fields in catalog.fields.items()}
        self._by_type: dict[str, list[int]] = {}
        for number, entry in enumerate(self._entries):
            for name in entry.types:
                self._by_type.setdefault(name, []).append(number)

    def find(self, terms: Iterable[str], may_read: Callable[[str], bool] | None = None) -> list[Hit]:
        """The entries that fit all terms, the best first; only those whose URLs may be read."""
        found: dict[int, list[_Fit]] | None = None
        for term in terms:
            fits = self._fits(term)
            if found is None:
                found = {number: [fit] for number, fit in fits.items()}
            else:
                found = {number: [*before, fits[number]] for number, before in found.items() if number in fits}
        hits = [
            Hit(self._rank(number, fits), self._entries[number], *max(fits, key=lambda fit: fit.match))
            for number, fits in (found or {}).items()
            if may_read is None or may_read(self._entries[number].url)
        ]
        return sorted(hits, key=lambda hit: hit.rank)

    def _rank(self, number: int, fits: list[_Fit]) -> Rank:
        entry = self._entries[number]
        return (
            sum(fit.match for fit in fits),
            _KIND_ORDER[entry.kind],
            entry.name.count("/"),
            len(entry.name),
            entry.name,
        )

    def _fits(self, term: str) -> dict[int, _Fit]:
        """How a term fits each entry, the best way; a term of several words (`image_raw`) fits where all of them do."""
        found: dict[int, _Fit] = {}
        for number, fit in self._single_fits(term):
            known = found.get(number)
            if known is None or fit.match < known.match:
                found[number] = fit
        parts = words_of(term)
        if not found and len(parts) > 1 and "/" not in term:
            each = [self._fits(part) for part in parts]
            shared = set(each[0]).intersection(*each[1:])
            return {number: max((fits[number] for fits in each), key=lambda fit: fit.match) for number in shared}
        return found

    def _single_fits(self, term: str) -> Iterator[tuple[int, _Fit]]:
        if "/" in term:
            yield from self._path_fits(term)
            return
        for word in self._words.beginning(term):
            matches = _EXACT if word == term else _PREFIX
            for number, place in self._words.places[word]:
                yield number, _Fit(matches[place])
        if len(term) >= _MIN_PART:
            yield from ((number, _Fit(Match.PART)) for number, name in enumerate(self._names) if term in name)
        for name, numbers in self._by_type.items():
            fit = self._type_fit(name, term)
            if fit is not None:
                for number in numbers:
                    yield number, fit

    def _path_fits(self, term: str) -> Iterator[tuple[int, _Fit]]:
        """A term with a slash is a part of a whole name, or of a type's."""
        for number, name in enumerate(self._names):
            if name == term:
                yield number, _Fit(Match.NAME)
            elif name.startswith(term):
                yield number, _Fit(Match.NAME_PREFIX)
            elif term in name:
                yield number, _Fit(Match.PART)
        for name, numbers in self._by_type.items():
            if name.casefold().startswith(term):
                for number in numbers:
                    yield number, _Fit(Match.TYPE if name.casefold() == term else Match.TYPE_PREFIX)

    def _type_fit(self, name: str, term: str) -> _Fit | None:
        """How a term fits a type: by a field's name, else by the words of its own."""
        prefix: _Fit | None = None
        for path in self._fields.get(name, ()):
            own = path.rpartition(".")[2].removesuffix("[]").casefold()
            if own == term or term in words_of(own):
                return _Fit(Match.FIELD, path)
            if prefix is None and any(word.startswith(term) for word in (own, *words_of(own))):
                prefix = _Fit(Match.FIELD_PREFIX, path)
        if prefix is not None:
            return prefix
        words = words_of(name)
        if term in words or name.rpartition("/")[2].casefold() == term:
            return _Fit(Match.TYPE)
        return _Fit(Match.TYPE_PREFIX) if any(word.startswith(term) for word in words) else None


def _places(entry: Entry) -> Iterator[tuple[str, _Place]]:
    """The words of an entry, each with where it is."""
    segments = [segment.casefold() for segment in entry.name.split("/") if segment]
    for segment in segments[:-1]:
        yield segment, _Place.SEGMENT
    yield from ((segment, _Place.LAST_SEGMENT) for segment in segments[-1:])
    for word in words_of(entry.name):
        yield word, _Place.WORD
    for text in entry.texts:
        for word in words_of(text):
            yield word, _Place.TEXT


def _index(occurrences: Iterable[tuple[int, Iterator[tuple[str, _Place]]]]) -> _Words:
    places: dict[str, list[tuple[int, _Place]]] = {}
    for number, words in occurrences:
        for word, place in words:
            places.setdefault(word, []).append((number, place))
    return _Words(places, tuple(sorted(places)))
