"""What a query asks of the past: which recorded messages may take part in a match, and what is told of them. Pure.

`?topic ros:past ?message` brings recorded messages to the default graph. The query sees all messages of the recordings
that it is about, as if they were all there; which of them are read is narrowed here, group by group, and only by what
every solution that counts must fulfil:

- a ros:past pattern matches messages of the topics, types and times that its own group tells (patterns, FILTER, BIND,
  VALUES), or that groups around it tell of variables that are bound before;
- any other pattern that can match a recorded message must be about one that such a pattern has: of its own group, of
  one that it is joined with, or of one around it and before it (OPTIONAL, MINUS, EXISTS). Else everything is read.

Patterns in GRAPH match nothing of it: what is brought has no graph of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol
from urllib.parse import unquote

from rosld.ontology.vocab import ldp, rdf, ros
from rosld.server.auth.permissions import Permissions
from rosld.server.http.problem import Problem
from rosld.server.sparql.intervals import ANY_TIME, Interval, Knowledge, date_time_interval, knowledge_of
from rosld.server.sparql.needs import document_of, groups_within, matches_any_node
from rosld.server.sparql.syntax.tree import (
    Group,
    Iri,
    Pattern,
    Query,
    Reference,
    Slice,
    Term,
    Value,
    Variable,
    strip_brackets,
)

_PAST = ros.past.value
_LINK, _RECEIVED, _NAME, _TYPE, _OF_RECORD = (
    frozenset({each.value}) for each in (ros.past, ros.received, ros.name, ros.hasMessageType, ros.recordedMessage)
)
_NOTHING = frozenset[str]()
_WITHIN = frozenset(each.value for each in (rdf.first, rdf.rest, ros.latest, ros.latestFrom, ros.recordedMessage))
"""Predicates that lead from a node to one of the same message, beside the fields of types."""
_CLASS = frozenset({rdf.type.value})
_CLASSES = frozenset(each.value for each in (ros.Record, ros.Elided, ldp.Resource, ldp.RDFSource))
PREDICATES = frozenset(
    each.value
    for each in (
        ros.past, ros.received, ros.sequence, ros.sentBy, ros.dateTime, ros.elidedLength, ros.bytes, ros.unreadable,
        ros.recordedIn, ros.index, ros.onTopic, ros.recordedAt, ros.opensRecording, ros.recordedMessage, rdf.type,
        rdf.first, rdf.rest,
    )
)  # fmt: skip
"""What is said of recorded messages and of their topics, beside the fields of their types."""
MAX_TEXT = 256 * 1024 * 1024
"""Characters of N-Triples that one query may have of them."""
_MOST_ROWS = 10_000
"""Rows of an answer, those that OFFSET leaves out included, up to which less than all is read for them."""


@dataclass(frozen=True, slots=True)
class MessageTerms:
    """The terms of messages. `types` is the namespace of message types, `base` begins the IRIs of this server."""

    types: str
    base: str

    def type_named(self, iri: str) -> str | None:
        """Return the message type (`geometry_msgs/msg/Twist`) that an IRI is the class, or a property, of."""
        return unquote(document_of(iri[len(self.types) :])) if iri.startswith(self.types) else None

    def stays_in_message(self, pattern: Pattern) -> bool:
        """Whether a match leads to a node of the same message, if it leads to a node that has triples."""
        predicates = pattern.predicates
        return predicates is not None and all(one in _WITHIN or one.startswith(self.types) for one in predicates)

    def types_of(self, pattern: Pattern) -> frozenset[str]:
        """Return the message type that the subject of a pattern must be of, or within; nothing if that is open."""
        named: set[str | None] = set()
        if not pattern.empty and pattern.predicates:
            named = {self.type_named(one) for one in pattern.predicates}
        is_of_type = pattern.predicates in (_CLASS, _TYPE) and not pattern.repeated
        if is_of_type and isinstance(pattern.object, Iri):
            named = {self.type_named(pattern.object.value)}
        return frozenset(one for one in named if one is not None) if len(named) == 1 else _NOTHING


@dataclass(frozen=True, slots=True)
class PastSelection:
    """Messages that were received at a `time`, of types that use all of `types`.

    Their topics have one of these `urls` and one of these `names` (None: any), and now all of `topic_types`.
    """

    urls: frozenset[str] | None = None
    names: frozenset[str] | None = None
    topic_types: frozenset[str] = frozenset()
    types: frozenset[str] = frozenset()
    time: Interval = ANY_TIME


class PastEnd(NamedTuple):
    """The newest, or the oldest, of the selected messages, which the first solutions of a query are about.

    While all that were received at a time, or on that side of it, are read, each solution with one of these is found
    and comes before those with any other. Once there are `rows` of them, nothing more need be read. At least `messages`
    are needed.
    """

    is_newest: bool
    rows: int
    messages: int


@dataclass(frozen=True, slots=True)
class _Context:
    """What holds around a group: of variables, of the topics that they are, and those that stand for messages."""

    known: Knowledge = field(default_factory=Knowledge)
    topics: Mapping[str, PastSelection] = field(default_factory=dict)
    covered: frozenset[str] = frozenset()

    def restrict(self, variables: frozenset[str]) -> _Context:
        """The same of these variables alone."""
        topics = {name: each for name, each in self.topics.items() if name in variables}
        return _Context(self.known.restrict(variables), topics, self.covered & variables)


class PastQuery:
    """A query about the past.

    `predicates` are those of recorded messages that it can match, None for all. `is_linked`: it matches nodes within
    messages only where these predicates lead to them from the messages. `recordings` are the URLs of the recordings
    that it names, itself or by their messages.
    """

    def __init__(self, query: Query, terms: MessageTerms) -> None:
        self._where = query.where
        self._terms = terms
        named = [each.predicates for group in _groups_of_default_graph(query.where) for each in group.patterns]
        self.predicates = None if None in named else frozenset().union(*(each for each in named if each is not None))
        self.recordings = frozenset(_recordings(query, terms.base))
        self.is_linked = True
        self.covered: Mapping[int, frozenset[str]] = self._message_variables_by_group()
        """The variables that stand for recorded messages or nodes in them, by the `id` of the group they are in."""
        self.end = self._end(query.slice)

    def selections(self, now: Interval) -> Sequence[PastSelection]:
        """The messages that may take part in a match, where NOW() is within an interval."""
        return list(dict.fromkeys(self._of(self._where, _Context(), now)))

    def _end(self, slice: Slice | None) -> PastEnd | None:
        """The messages that the first solutions are about, None where they may be about any.

        Where one pattern alone selects messages, and in every solution, and all other patterns match only what is said
        of that message, the messages that are not read have no part in a solution with one that is: not even in what
        OPTIONAL, MINUS and EXISTS find for it.
        """
        own = [each for each in self._where.patterns if _is_past(each)]
        if slice is None or not 1 <= slice.limit + slice.offset <= _MOST_ROWS or slice.limit == 0 or len(own) != 1:
            return None
        (pattern,) = own
        if not isinstance(pattern.object, Variable) or len([*self._of(self._where, _Context(), ANY_TIME)]) != 1:
            return None
        found = PastEnd(slice.is_descending or slice.first is None, slice.limit, slice.limit + slice.offset)
        if slice.first is None:  # any solutions will do, but those of the next page must be others
            return found if slice.offset == 0 else None
        key = strip_brackets(slice.first)
        if not isinstance(key, Reference):
            return None
        time = Variable(key.name[1:])
        is_time = any(
            (each.subject, each.predicates, each.object) == (pattern.object, _RECEIVED, time) and not each.repeated
            for each in self._where.patterns
        )
        return found if is_time else None

    def _message_variables_by_group(self) -> Mapping[int, frozenset[str]]:
        found: dict[int, frozenset[str]] = {}
        for _ in self._of(self._where, _Context(), ANY_TIME, found):
            pass
        return found

    def _of(
        self, group: Group, outer: _Context, now: Interval, seen: dict[int, frozenset[str]] | None = None
    ) -> Iterator[PastSelection]:
        if group.graph is not None:
            return
        known = knowledge_of(group, outer.known, now)
        topics = {**outer.topics, **self._topics(group, known, outer.topics)}
        own = [each for each in group.patterns if _is_past(each)]
        ends = {each.object.name for each in own if isinstance(each.object, Variable)}
        below = self._spread(group, outer.covered | ends)
        covered = self._spread(group, below | self._certain_of_children(group))
        if seen is not None:
            seen[id(group)] = covered
        for pattern in own:
            if not (isinstance(pattern.object, Variable) and pattern.object.name in outer.covered):
                yield self._selection(pattern, group, known, topics)
        for pattern in group.patterns:
            if pattern not in own and not self._is_about(pattern, covered) and self._may_match(pattern, group):
                self.is_linked = False
                yield PastSelection(urls=_topic_of(pattern))
        around = _Context(known, topics, below)  # not what children say: two of them might rely on each other
        for child in group.children:
            if child.scoped:
                inner = _Context()
            elif child.joined:
                inner = around
            else:
                inner = around.restrict(child.given)
            yield from self._of(child, inner, now, seen)
        bound = _bound(group) | self._certain_of_children(group)
        for child in group.filters:
            yield from self._of(child, _Context(known, topics, covered).restrict(bound), now, seen)

    # --- what a pattern selects

    def _selection(
        self, pattern: Pattern, group: Group, known: Knowledge, topics: Mapping[str, PastSelection]
    ) -> PastSelection:
        topic, message = pattern.subject, pattern.object
        found = PastSelection()
        if isinstance(topic, Variable):
            found = topics.get(topic.name, found)
        elif isinstance(topic, Iri):
            found = PastSelection(urls=frozenset({topic.value}))
        if not isinstance(message, Variable):
            return found
        about = [each for each in group.patterns if each.subject == message]
        types = frozenset().union(*(self._terms.types_of(each) for each in about))
        time = ANY_TIME
        for each in about:
            if each.predicates == _RECEIVED and not each.repeated:
                time = time.meet(_time_of(each.object, known))
        return replace(found, types=types, time=time)

    def _topics(
        self, group: Group, known: Knowledge, outer: Mapping[str, PastSelection]
    ) -> Mapping[str, PastSelection]:
        """What the patterns of a group tell of its variables, as far as they are topics."""
        found: dict[str, PastSelection] = {}
        for name in sorted({each.subject.name for each in group.patterns if isinstance(each.subject, Variable)}):
            one = outer.get(name, PastSelection())
            if name in known.terms:
                one = replace(one, urls=_meet(one.urls, _iris(known.terms[name])))
            for each in group.patterns:
                if each.subject != Variable(name) or each.repeated or each.empty or each.predicates is None:
                    continue
                if each.predicates == _NAME:
                    one = replace(one, names=_meet(one.names, _texts(each.object, known)))
                elif each.predicates == _TYPE and isinstance(each.object, Iri):
                    type = self._terms.type_named(each.object.value)
                    one = replace(one, topic_types=one.topic_types | ({type} if type else _NOTHING))
            found[name] = one
        return found

    # --- what is about a recorded message

    def _may_match(self, pattern: Pattern, group: Group) -> bool:
        """Whether it can match what is said of a recorded message, or that a topic has one."""
        if matches_any_node(pattern, group.patterns):
            return True
        predicates = pattern.predicates
        if predicates == _CLASS and isinstance(pattern.object, Iri) and not pattern.repeated:
            return pattern.object.value.startswith(self._terms.types) or pattern.object.value in _CLASSES
        is_said = predicates is None or any(
            each in PREDICATES or each.startswith(self._terms.types) for each in predicates
        )
        if not isinstance(pattern.subject, Iri) or pattern.repeated:
            return is_said
        place = pattern.subject.value.removeprefix(self._terms.base)
        is_topic = place.startswith("topics/") and (predicates is None or _PAST in predicates)
        return is_said and (is_topic or place.startswith("bags/"))

    def _is_about(self, pattern: Pattern, covered: frozenset[str]) -> bool:
        """Whether it matches only what is said of a node of a covered message."""
        if pattern.repeated or pattern.empty:
            stays = self._terms.stays_in_message(pattern)
            ends = [each.name for each in (pattern.subject, pattern.object) if isinstance(each, Variable)]
            return stays and not covered.isdisjoint(ends)
        if isinstance(pattern.subject, Variable) and pattern.subject.name in covered:
            return True
        is_of_record = pattern.predicates == _OF_RECORD
        return is_of_record and isinstance(pattern.object, Variable) and pattern.object.name in covered

    def _spread(self, group: Group, covered: frozenset[str]) -> frozenset[str]:
        """With the variables that patterns of a group lead to within the same messages, and to their records."""
        while True:
            found = covered
            for each in group.patterns:
                if not self._terms.stays_in_message(each) or not isinstance(each.object, Variable):
                    continue
                if isinstance(each.subject, Variable):
                    if each.subject.name in found:
                        found |= {each.object.name}
                    elif each.object.name in found and each.predicates == _OF_RECORD:
                        found |= {each.subject.name}
            if found == covered:
                return covered
            covered = found

    def _certain(self, group: Group) -> frozenset[str]:
        """The variables that stand for recorded messages in every solution of a group that is joined."""
        if group.graph is not None:
            return _NOTHING
        own = (each.object.name for each in group.patterns if _is_past(each) and isinstance(each.object, Variable))
        found = self._spread(group, frozenset(own)) | self._certain_of_children(group)
        return found & group.visible

    def _certain_of_children(self, group: Group) -> frozenset[str]:
        inner = (each for each in group.children if (each.joined and not each.alternative) or each.scoped)
        return frozenset().union(*map(self._certain, inner))


def past_query(query: Query, terms: MessageTerms) -> PastQuery | None:
    """What a query asks of the past, None where it does not. Raises Problem 400 for a ros:past in GRAPH."""
    groups = list(groups_within(query.where))
    asking = [group for group in groups if any(_PAST in (each.predicates or ()) for each in group.patterns)]
    if not asking:
        return None
    if any(group.graph is not None for group in asking):
        raise Problem(
            400,
            "ros:past stands in a GRAPH: recorded messages have none, they are in the default graph. To say of which "
            f"recording, write ?message ros:recordedIn <{terms.base}bags/NAME/>.",
        )
    return PastQuery(query, terms)


def _groups_of_default_graph(group: Group) -> Iterator[Group]:
    """The groups whose patterns are matched in the default graph."""
    return (each for each in groups_within(group) if each.graph is None)


def _is_past(pattern: Pattern) -> bool:
    return pattern.predicates == _LINK and not pattern.repeated and not pattern.empty


def _topic_of(pattern: Pattern) -> frozenset[str] | None:
    """The only topic whose messages a pattern with any predicate can match, None where it may be of others."""
    is_of_one = isinstance(pattern.subject, Iri) and "/bags/" not in pattern.subject.value and not pattern.repeated
    return frozenset({pattern.subject.value}) if is_of_one and isinstance(pattern.subject, Iri) else None


def _bound(group: Group) -> frozenset[str]:
    ends = (term for each in group.patterns for term in (each.subject, each.object))
    return frozenset(term.name for term in ends if isinstance(term, Variable))


def _time_of(term: Term, known: Knowledge) -> Interval:
    if isinstance(term, Variable):
        return known.of_time(term.name)
    return (date_time_interval(term) if isinstance(term, Value) else None) or ANY_TIME


def _texts(term: Term, known: Knowledge) -> frozenset[str] | None:
    """The strings that a term can be, None for any."""
    if isinstance(term, Value):
        return frozenset({term.literal.value})
    terms = known.terms.get(term.name) if isinstance(term, Variable) else frozenset()
    return None if terms is None else frozenset(each.literal.value for each in terms if isinstance(each, Value))


def _iris(terms: Iterable[Iri | Value]) -> frozenset[str]:
    return frozenset(each.value for each in terms if isinstance(each, Iri))


def _meet(one: frozenset[str] | None, other: frozenset[str] | None) -> frozenset[str] | None:
    if one is None or other is None:
        return other if one is None else one
    return one & other


def _recordings(query: Query, base: str) -> Iterator[str]:
    """The URLs of recordings that a query names, itself or by what is in them."""
    below = f"{base}bags/"
    terms = (
        term for group in groups_within(query.where) for each in group.patterns for term in (each.subject, each.object)
    )
    for iri in (*query.constants, *query.default, *(term.value for term in terms if isinstance(term, Iri))):
        document = document_of(iri)
        if document.startswith(below) and "/" in document[len(below) :]:
            yield below + document[len(below) :].partition("/")[0] + "/"


class PastText(NamedTuple):
    """What is said of recorded messages, as N-Triples; `is_whole`: of all that were asked for."""

    text: bytes
    is_whole: bool = True


class PastSource(Protocol):
    """Reads recorded messages. Called on the loop."""

    async def read(
        self,
        asked: PastQuery,
        graphs: tuple[str, ...],
        permissions: Permissions,
        now: Interval,
        until: float,
        most: int | None = None,
    ) -> PastText:
        """What is said of the messages that a query asks for, as far as they may be read.

        Of about `most` messages where that is a number: those at the query's `end`, all that were received at a time,
        or on that side of it. `graphs` are those that the default graph is made of, none for all. NOW() will be within
        `now`; `until` is when the time is over (monotonic). Raises Problems: 400 where there is no past to be read, 503
        for too much.
        """
        ...
