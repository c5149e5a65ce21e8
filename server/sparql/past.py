"""Recorded messages that a query can match, and the predicates it uses on them. Pure.

`?topic ros:past ?message` adds recorded messages to the default graph. A query behaves as if all messages of the
recordings it names were present; the analysis narrows, group by group, the messages that are read, using only
constraints that every relevant solution must satisfy:

- a ros:past pattern matches messages of the topics, types and times that its own group specifies (patterns, FILTER,
  BIND, VALUES), or that enclosing groups specify for variables bound earlier;
- `BIND(ros:asOf(?topic, ?time) AS ?message)` matches messages of this topic up to this time, and one before its
  earliest; `BIND(ros:previous(?other) AS ?message)` those that `?other` matches, and one before;
- any other pattern that can match a recorded message must concern a message of such a pattern: in its own group, in a
  group it is joined with, or in an enclosing one before it (OPTIONAL, MINUS, EXISTS). Otherwise everything is read.

Patterns in GRAPH do not match recorded messages, which have no graph of their own.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import takewhile
from typing import NamedTuple, Protocol
from urllib.parse import unquote

from msgspec import Struct, field
from msgspec.structs import replace

from rosld.ontology import geometry
from rosld.ontology.vocab import ldp, rdf, ros
from rosld.server.auth.permissions import Permissions
from rosld.server.dataset.encoding import NAMESPACE
from rosld.server.http.problem import Problem
from rosld.server.space.transforms import FrameRow
from rosld.server.sparql.intervals import (
    ANY_TIME,
    Bounds,
    Interval,
    Knowledge,
    date_time_interval,
    knowledge_of,
    time_of,
)
from rosld.server.sparql.message_order import AS_OF, FUNCTIONS, MessageTimes
from rosld.server.sparql.needs import document_of, groups_within, matches_any_node
from rosld.server.sparql.ros_functions import TRANSFORM
from rosld.server.sparql.summaries import SummaryQuery
from rosld.server.sparql.syntax.expressions import calls_within
from rosld.server.sparql.syntax.tree import (
    Call,
    Constant,
    Group,
    Iri,
    Pattern,
    Query,
    Reference,
    Slice,
    Term,
    Value,
    Variable,
    message_call,
    strip_brackets,
    variables_in,
)

_PAST = ros.past.value
_LINK, _RECEIVED, _NAME, _TYPE, _OF_RECORD, _IN = (
    frozenset({each.value})
    for each in (ros.past, ros.received, ros.name, ros.hasMessageType, ros.recordedMessage, ros.recordedIn)
)
_MAX_PATH = 16
"""Maximum number of fields from a message to a number."""
_NOTHING = frozenset[str]()
_OF_ROBOT = r"(?:robots/[^/]+/)?"
"""Pattern of the path of a robot below the base of a server of several."""
_WITHIN = geometry.TERMS.union(
    each.value for each in (rdf.first, rdf.rest, ros.latest, ros.latestFrom, ros.recordedMessage)
)
"""Predicates from a node to another node of the same message, in addition to the fields of types."""
_CLASS = frozenset({rdf.type.value})
_CLASSES = geometry.CLASSES.union(each.value for each in (ros.Record, ros.Elided, ldp.Resource, ldp.RDFSource))
PREDICATES = geometry.TERMS.union(
    each.value
    for each in (
        ros.past, ros.received, ros.sequence, ros.sentBy, ros.dateTime, ros.elidedLength, ros.bytes, ros.unreadable,
        ros.recordedIn, ros.index, ros.onTopic, ros.recordedAt, ros.opensRecording, ros.recordedMessage, rdf.type,
        rdf.first, rdf.rest,
    )
)  # fmt: skip
"""Predicates of recorded messages and of their topics, in addition to the fields of their types."""
MAX_TEXT = 256 * 1024 * 1024
"""Maximum number of characters of N-Triples about recorded messages per query."""
_MOST_ROWS = 10_000
"""Maximum number of rows (including those skipped by OFFSET) for which only part of the messages is read."""


class MessageTerms(Struct, frozen=True):
    """Terms of messages. `types` is the namespace of message types, `base` is the prefix of this server's IRIs."""

    types: str
    base: str

    def type_named(self, iri: str) -> str | None:
        """Return the message type (`geometry_msgs/msg/Twist`) whose class or property an IRI is."""
        return unquote(document_of(iri[len(self.types) :])) if iri.startswith(self.types) else None

    def stays_in_message(self, pattern: Pattern) -> bool:
        """Whether every match leads to a node of the same message or to a node without triples."""
        predicates = pattern.predicates
        return predicates is not None and all(one in _WITHIN or one.startswith(self.types) for one in predicates)

    def types_of(self, pattern: Pattern) -> frozenset[str]:
        """Return the message type that the subject of a pattern must have or be part of; nothing if that is open."""
        named: set[str | None] = set()
        if not pattern.empty and pattern.predicates:
            named = {self.type_named(one) for one in pattern.predicates}
        is_of_type = pattern.predicates in (_CLASS, _TYPE) and not pattern.repeated
        if is_of_type and isinstance(pattern.object, Iri):
            named = {self.type_named(pattern.object.value)}
        return frozenset(one for one in named if one is not None) if len(named) == 1 else _NOTHING


class PastSelection(Struct, frozen=True):
    """Selection of messages received within `time`, of types that use all of `types`.

    Their topics have one of these `urls` and one of these `names` (None: any), and currently all of `topic_types`. They
    are in one of these `recordings` (None: any), and in one of those that the query `choice` finds, if there is one.
    `numbers` are the intervals of their numbers, by path (predicates from the message on). `before` is the number of
    messages of each topic before `time` that are selected, too. `variable` stands for the messages ("": for any).
    """

    urls: frozenset[str] | None = None
    names: frozenset[str] | None = None
    topic_types: frozenset[str] = frozenset()
    types: frozenset[str] = frozenset()
    time: Interval = ANY_TIME
    before: int = 0
    variable: str = ""
    recordings: frozenset[str] | None = None
    choice: str | None = None
    numbers: tuple[tuple[tuple[str, ...], Bounds], ...] = ()


class PastEnd(NamedTuple):
    """Newest or oldest of the selected messages, which the first solutions of a query are about.

    If all messages up to, or from, some time are read, every solution with one of them is found and sorts before all
    others. Once there are `rows` of them, no more messages need be read. At least `messages` are needed.
    """

    is_newest: bool
    rows: int
    messages: int


class _Context(Struct, frozen=True):
    """Context of a group: constraints on variables, the topics they stand for, and the variables of known messages."""

    known: Knowledge = field(default_factory=Knowledge)
    topics: Mapping[str, PastSelection] = field(default_factory=dict)
    covered: frozenset[str] = frozenset()

    def restrict(self, variables: frozenset[str]) -> _Context:
        topics = {name: each for name, each in self.topics.items() if name in variables}
        return _Context(self.known.restrict(variables), topics, self.covered & variables)


class PastQuery:
    """A query about the past.

    `predicates` are the predicates of recorded messages that it can match, None for all. `is_linked`: it reaches nodes
    within messages only through these predicates from the messages. Each path of fields in `paths` is one predicate of
    the rewritten query; their places are `replaced`. `is_ordered`: it calls functions of the order of messages.
    `recordings` are the URLs of the recordings that it names, directly or by their messages; `asks_all`: it is about
    all recordings, because a message is recorded in a variable that may be any.
    """

    def __init__(self, query: Query, terms: MessageTerms) -> None:
        self._query = query
        self._terms = terms
        named = [each.predicates for group in _groups_of_default_graph(query.where) for each in group.patterns]
        self.predicates = None if None in named else frozenset().union(*(each for each in named if each is not None))
        self.recordings = frozenset(_recordings(query, terms.base))
        self.is_linked = True
        self.covered: Mapping[int, frozenset[str]] = self._message_variables_by_group()
        """Variables that stand for recorded messages or nodes in them, by the `id` of their group."""
        self.paths: dict[str, tuple[str, ...]] = {}
        self.replaced: list[tuple[int, int, str]] = []
        self._common, self._kept, self._by_variable = _NOTHING, _NOTHING, dict[str, frozenset[str]]()
        if self.predicates is not None:
            self._find_predicates()
        self.end = self._end(query.slice)
        self.asks_all = self._asks_all(query.where, Knowledge())

    @property
    def asks_transforms(self) -> bool:
        return TRANSFORM in self._query.functions

    @property
    def is_ordered(self) -> bool:
        return not self._query.functions.isdisjoint(FUNCTIONS)

    def selections(self, now: Interval) -> Sequence[PastSelection]:
        """Return the selections of messages that may take part in a match, for NOW() within an interval."""
        return list(dict.fromkeys(self._of(self._query.where, _Context(), now)))

    def recorded_patterns(self) -> Collection[tuple[int, Pattern]]:
        """Return the patterns that match only recorded messages, each with the `id` of its group."""
        return {
            (id(group), each)
            for group in _groups_of_default_graph(self._query.where)
            for each in group.patterns
            if _is_past(each) or self._is_about(each, self.covered.get(id(group), _NOTHING))
        }

    def predicates_of(self, variables: Collection[str]) -> frozenset[str] | None:
        """Return the predicates that the query can match on messages of these variables, None for all."""
        if self.predicates is None:
            return None
        of_each = (self._by_variable.get(each, _NOTHING) if each else self._kept for each in variables)
        return self._common.union(*of_each)

    def _find_predicates(self) -> None:
        """Find the predicates of the messages of each variable, with a single predicate for a path of fields.

        A field has one value, so that a path matches a message once, as a predicate does.
        """
        groups = [*_groups_of_default_graph(self._query.where)]
        roots = self._roots([each for group in groups for each in group.patterns])
        found: dict[str | None, set[str]] = {}
        predicates: dict[tuple[str, ...], str] = {}
        for group in groups:
            covered = self.covered.get(id(group), _NOTHING)
            within: set[Pattern] = set()
            for chain in group.chains:
                at = int(chain.steps[0] == _PAST)  # the path begins at a topic
                subject, steps = chain.patterns[at].subject, chain.steps[at:]
                name = subject.name if isinstance(subject, Variable) else ""
                fields = steps[:-1] if steps[-1] == ros.dateTime.value else steps
                is_of_fields = all(self._terms.type_named(each) is not None for each in fields)
                if is_of_fields and len(steps) > 1 and name in covered and roots.get(name) == name:
                    predicate = predicates.setdefault(steps, f"{NAMESPACE}path:{len(predicates)}")
                    self.replaced.append((chain.starts[at], chain.end, predicate))
                    within.update(chain.patterns[at:])
                    found.setdefault(name, set()).add(predicate)
            for each in group.patterns:
                end = each.object if _is_past(each) else each.subject
                root = roots.get(end.name) if isinstance(end, Variable) and end.name in covered else None
                if (each.repeated or each.empty) and not self._terms.stays_in_message(each):
                    root = None
                if each not in within:
                    found.setdefault(root, set()).update(each.predicates or ())
        self.paths = {predicate: steps for steps, predicate in predicates.items()}
        self.replaced = sorted(set(self.replaced))  # a path before several objects is written once
        self._common = frozenset(found.pop(None, ()))
        self._by_variable = {name: frozenset(each) for name, each in found.items() if name is not None}
        self._kept = self._common.union(*self._by_variable.values())

    def _roots(self, patterns: Sequence[Pattern]) -> Mapping[str, str | None]:
        """Return the variables of the messages that variables are or are nodes of, None if that is ambiguous."""
        messages = {name for group in _groups_of_default_graph(self._query.where) for name in _links(group)}
        roots: dict[str, str | None] = {name: name for name in messages}
        before: dict[str, str | None] = {}
        steps = [each for each in patterns if not _is_past(each) and self._terms.stays_in_message(each)]
        others = [each for each in patterns if not _is_past(each) and each not in steps]
        roots |= {each.object.name: None for each in others if isinstance(each.object, Variable)}
        while before != roots:
            before = dict(roots)
            for each in steps:
                ends = each.subject, each.object
                names = [end.name for end in ends if isinstance(end, Variable)]
                if len(names) == 2 and names[0] in roots:
                    root = roots[names[0]]
                    roots[names[1]] = root if roots.get(names[1], root) == root else None
        return roots

    def _asks_all(self, group: Group, outer: Knowledge) -> bool:
        """Whether a pattern says that something is recorded in a variable whose values are not given."""
        if group.graph is not None:
            return False
        known = knowledge_of(group, outer, ANY_TIME)
        bags = (
            each.object
            for each in group.patterns
            if (each.predicates or _NOTHING) >= _IN and isinstance(each.subject, Variable)
        )
        return any(isinstance(bag, Variable) and bag.name not in known.terms for bag in bags) or any(
            self._asks_all(each, known if each.joined and not each.scoped else Knowledge())
            for each in (*group.children, *group.filters)
        )

    def _end(self, slice: Slice | None) -> PastEnd | None:
        """Return the messages that the first solutions are about, None if they may be about any.

        If exactly one pattern selects messages, in every solution, and all other patterns match only triples of that
        message, then unread messages cannot take part in a solution with a read one, not even through OPTIONAL, MINUS
        and EXISTS.
        """
        own = [each for each in self._query.where.patterns if _is_past(each)]
        if slice is None or not 1 <= slice.limit + slice.offset <= _MOST_ROWS or slice.limit == 0 or len(own) != 1:
            return None
        (pattern,) = own
        if not isinstance(pattern.object, Variable) or len([*self._of(self._query.where, _Context(), ANY_TIME)]) != 1:
            return None
        found = PastEnd(slice.is_descending or slice.first is None, slice.limit, slice.limit + slice.offset)
        if slice.first is None:  # any solutions will do, but the next page must have others
            return found if slice.offset == 0 else None
        key = strip_brackets(slice.first)
        if not isinstance(key, Reference):
            return None
        time = Variable(key.name[1:])
        is_time = any(
            (each.subject, each.predicates, each.object) == (pattern.object, _RECEIVED, time) and not each.repeated
            for each in self._query.where.patterns
        )
        return found if is_time else None

    def _message_variables_by_group(self) -> Mapping[int, frozenset[str]]:
        found: dict[int, frozenset[str]] = {}
        for _ in self._of(self._query.where, _Context(), ANY_TIME, found):
            pass
        return found

    def _of(
        self, group: Group, outer: _Context, now: Interval, covered_by_group: dict[int, frozenset[str]] | None = None
    ) -> Iterator[PastSelection]:
        if group.graph is not None:
            return
        known = knowledge_of(group, outer.known, now)
        topics = {**outer.topics, **self._topics(group, known, outer.topics)}
        own = [each for each in group.patterns if _is_past(each)]
        ends = _links(group)
        below = self._spread(group, outer.covered | ends)
        covered = self._spread(group, below | self._certain_of_children(group))
        if covered_by_group is not None:
            covered_by_group[id(group)] = covered
        for pattern in own:
            if not (isinstance(pattern.object, Variable) and pattern.object.name in outer.covered):
                yield self._selection(pattern, group, known, topics, covered)
        for name, operand in group.bindings:
            if (call := message_call(operand)) is not None:
                yield from self._ordered(name, call, group, _Context(known, topics, covered), now)
        for pattern in group.patterns:
            if pattern not in own and not self._is_about(pattern, covered) and self._may_match(pattern, group):
                self.is_linked = False
                yield PastSelection(urls=_topic_of(pattern))
        around = _Context(known, topics, below)  # not the constraints of children: two of them might rely on each other
        for child in group.children:
            if child.scoped:
                inner = _Context()
            elif child.joined:
                inner = around
            else:
                inner = around.restrict(child.given)
            yield from self._of(child, inner, now, covered_by_group)
        bound = _bound(group) | ends | self._certain_of_children(group)
        for child in group.filters:
            yield from self._of(child, _Context(known, topics, covered).restrict(bound), now, covered_by_group)

    # --- selections

    def _selection(
        self,
        pattern: Pattern,
        group: Group,
        known: Knowledge,
        topics: Mapping[str, PastSelection],
        covered: frozenset[str],
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
        found, time = replace(found, variable=message.name), ANY_TIME
        for each in about:
            if each.predicates == _RECEIVED and not each.repeated:
                time = time.meet(_time_of(each.object, known))
        bags = self._bags(message, group)
        return replace(
            found,
            types=types,
            time=time,
            recordings=_recordings_of(bags, known),
            choice=next((text for bag in bags if (text := self._choice(bag, group, covered))), None),
            numbers=() if self.is_ordered else tuple(self._numbers(message, (), group, known)),
        )

    def _bags(self, message: Variable, group: Group) -> Sequence[Term]:
        """Return what a message, or its record, is said to be recorded in."""
        records = {each.subject for each in group.patterns if _is_plain(each, _OF_RECORD) and each.object == message}
        return [each.object for each in group.patterns if _is_plain(each, _IN) and each.subject in {message, *records}]

    def _numbers(
        self, node: Variable, path: tuple[str, ...], group: Group, known: Knowledge
    ) -> Iterator[tuple[tuple[str, ...], Bounds]]:
        """Yield the paths from a node of a message to bounded numbers, and their bounds."""
        for each in group.patterns:
            if each.subject != node or not isinstance(each.object, Variable) or not _is_plain(each, each.predicates):
                continue
            [predicate] = each.predicates or (None,)
            if predicate is None or not predicate.startswith(self._terms.types) or len(path) > _MAX_PATH:
                continue
            if each.object.name in known.numbers:
                yield (*path, predicate), known.numbers[each.object.name]
            yield from self._numbers(each.object, (*path, predicate), group, known)

    def _choice(self, bag: Term, group: Group, covered: frozenset[str]) -> str | None:
        """Return a query for the recordings that patterns of a group select which are about no message, if any do."""
        if not isinstance(bag, Variable):
            return None
        patterns = [
            each
            for each in group.patterns
            if _is_plain(each, each.predicates)
            and covered.isdisjoint(_names(each))
            and not _is_past(each)
            and not self._may_match(each, group)
        ]
        bound, found = {bag.name}, list[Pattern]()
        while more := [each for each in patterns if each not in found and not bound.isdisjoint(_names(each))]:
            found += more
            bound = bound.union(*map(_names, more))
        tests = [each for each in group.tests if (names := variables_in(each)) and names <= bound]
        if not any(not isinstance(each.object, Variable) and each.predicates != _CLASS for each in found) and not (
            found and tests
        ):
            return None
        lines = [f"{_written(each.subject)} <{min(each.predicates or ())}> {_written(each.object)} ." for each in found]
        lines += [f"FILTER({self._query.text[each.start : each.end]})" for each in tests]
        prologue = self._query.text[: self._query.start]
        return f"{prologue}SELECT DISTINCT {_written(bag)} WHERE {{ {' '.join(lines)} }}"

    def _ordered(self, name: str, call: Call, group: Group, around: _Context, now: Interval) -> Iterator[PastSelection]:
        """Yield the selections of a call of `ros:asOf` or `ros:previous`."""
        first = strip_brackets(call.arguments[0]) if call.arguments else None
        if call.iri == AS_OF:
            topic: Term = Variable(first.name[1:]) if isinstance(first, Reference) else Variable("")
            if isinstance(first, Constant):
                topic = first.term
            pattern = Pattern(topic, _LINK, Variable(name))
            found = self._selection(pattern, group, around.known, around.topics, around.covered)
            time = time_of(call.arguments[1], around.known, now) if len(call.arguments) == 2 else ANY_TIME
            yield replace(found, time=time, before=1, recordings=None, choice=None)  # the newest of all recordings
            return
        of = first.name[1:] if isinstance(first, Reference) else ""
        sources = [
            self._selection(each, group, around.known, around.topics, around.covered)
            for each in group.patterns
            if _is_past(each) and each.object == Variable(of)
        ]
        for other, operand in takewhile(lambda binding: binding[0] != name, group.bindings):
            if other == of and (before := message_call(operand)) is not None:
                sources += self._ordered(other, before, group, around, now)
        for child in group.children if not sources else ():
            sources += self._of(child, _Context(), now)
        yield from (replace(each, before=each.before + 1, variable=name) for each in sources or [PastSelection()])

    def _topics(
        self, group: Group, known: Knowledge, outer: Mapping[str, PastSelection]
    ) -> Mapping[str, PastSelection]:
        """Return the topics that the patterns of a group say its variables are."""
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

    # --- patterns about recorded messages

    def _may_match(self, pattern: Pattern, group: Group) -> bool:
        """Whether a pattern can match a triple of a recorded message, or a ros:past triple of a topic."""
        if matches_any_node(pattern, group.patterns):
            return True
        predicates = pattern.predicates
        if predicates == _CLASS and isinstance(pattern.object, Iri) and not pattern.repeated:
            return pattern.object.value.startswith(self._terms.types) or pattern.object.value in _CLASSES
        has_predicate = predicates is None or any(
            each in PREDICATES or each.startswith(self._terms.types) for each in predicates
        )
        if not isinstance(pattern.subject, Iri) or pattern.repeated:
            return has_predicate
        place = re.sub(f"^{_OF_ROBOT}", "", pattern.subject.value.removeprefix(self._terms.base))
        is_topic = place.startswith("topics/") and (predicates is None or _PAST in predicates)
        return has_predicate and (is_topic or place.startswith("bags/"))

    def _is_about(self, pattern: Pattern, covered: frozenset[str]) -> bool:
        """Whether a pattern matches only triples of nodes of a covered message."""
        if pattern.repeated or pattern.empty:
            stays = self._terms.stays_in_message(pattern)
            ends = [each.name for each in (pattern.subject, pattern.object) if isinstance(each, Variable)]
            return stays and not covered.isdisjoint(ends)
        if isinstance(pattern.subject, Variable) and pattern.subject.name in covered:
            return True
        is_of_record = pattern.predicates == _OF_RECORD
        return is_of_record and isinstance(pattern.object, Variable) and pattern.object.name in covered

    def _spread(self, group: Group, covered: frozenset[str]) -> frozenset[str]:
        """Add the variables that patterns of a group reach within the same messages, and their records."""
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
        """Return the variables that stand for recorded messages in every solution of a joined group."""
        if group.graph is not None:
            return _NOTHING
        found = self._spread(group, _links(group)) | self._certain_of_children(group)
        return found & group.visible

    def _certain_of_children(self, group: Group) -> frozenset[str]:
        inner = (each for each in group.children if (each.joined and not each.alternative) or each.scoped)
        return frozenset().union(*map(self._certain, inner))


def past_query(query: Query, terms: MessageTerms) -> PastQuery | None:
    """Return the past query within a query, None if there is none. Raises Problem 400 for a ros:past in GRAPH."""
    groups = list(groups_within(query.where))
    asking = [
        group
        for group in groups
        if any(_PAST in (each.predicates or ()) for each in group.patterns)
        or any(message_call(operand) is not None for _, operand in group.bindings)
    ]
    _require_bound(query, groups)
    if not asking:
        return None
    if any(group.graph is not None for group in asking):
        raise Problem(
            400,
            "ros:past, ros:asOf or ros:previous is inside a GRAPH, but recorded messages are in the default graph. To "
            f"select a recording, write ?message ros:recordedIn <{terms.base}bags/NAME/>.",
        )
    return PastQuery(query, terms)


def _require_bound(query: Query, groups: Iterable[Group]) -> None:
    """Raise a 400 Problem for a call of `ros:asOf` or `ros:previous` that is not what a BIND binds."""
    calls = (message_call(operand) for group in groups for _, operand in group.bindings)
    bound = {each.start for each in calls if each is not None}
    for each in query.expressions:
        for call in calls_within(each.operand):
            if call.iri in FUNCTIONS and call.start not in bound:
                name = "ros:asOf(?topic, ?time)" if call.iri == AS_OF else "ros:previous(?other)"
                raise Problem(400, f"{name} must be the whole expression of a BIND: BIND({name} AS ?message).")


def _links(group: Group) -> frozenset[str]:
    """Return the variables that a group binds to recorded messages."""
    own = (each.object for each in group.patterns if _is_past(each))
    return frozenset(each.name for each in own if isinstance(each, Variable)).union(
        name for name, operand in group.bindings if message_call(operand) is not None
    )


def _groups_of_default_graph(group: Group) -> Iterator[Group]:
    return (each for each in groups_within(group) if each.graph is None)


def _is_plain(pattern: Pattern, predicates: frozenset[str] | None) -> bool:
    """Whether a pattern matches single triples with one of these predicates."""
    return pattern.predicates == predicates and not (pattern.repeated or pattern.empty) and len(predicates or ()) == 1


def _names(pattern: Pattern) -> frozenset[str]:
    return frozenset(each.name for each in (pattern.subject, pattern.object) if isinstance(each, Variable))


def _written(term: Term) -> str:
    """Return a term as it is written in a query."""
    if isinstance(term, Variable):
        return f"?rosld_{re.sub('[^A-Za-z0-9]', '_', term.name)}" if term.is_blank else f"?{term.name}"
    return f"<{term.value}>" if isinstance(term, Iri) else str(term.literal)


def _recordings_of(bags: Sequence[Term], known: Knowledge) -> frozenset[str] | None:
    """Return the recordings that all of these terms can be, None for any."""
    found: frozenset[str] | None = None
    for bag in bags:
        if isinstance(bag, Variable):
            found = _meet(found, _iris(known.terms[bag.name]) if bag.name in known.terms else None)
        else:
            found = _meet(found, frozenset({bag.value}) if isinstance(bag, Iri) else _NOTHING)
    return found


def _is_past(pattern: Pattern) -> bool:
    return pattern.predicates == _LINK and not pattern.repeated and not pattern.empty


def _topic_of(pattern: Pattern) -> frozenset[str] | None:
    """Return the only topic whose messages a pattern with any predicate can match, None if there may be others."""
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
    """Return the strings that a term can be, None for any."""
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
    """Yield the URLs of recordings that a query names directly or by their contents."""
    recording = re.compile(f"{re.escape(base)}{_OF_ROBOT}bags/[^/]*/")
    terms = (
        term for group in groups_within(query.where) for each in group.patterns for term in (each.subject, each.object)
    )
    for iri in (*query.constants, *query.default, *(term.value for term in terms if isinstance(term, Iri))):
        if found := recording.match(document_of(iri)):
            yield found[0]


class PastText(NamedTuple):
    """N-Triples about recorded messages, and others that are `stored` in their stored form.

    `is_whole`: all requested messages are included.
    `transforms` are those around the times of the places in the text, if the query calls ros:transform; `times` are the
    times of all messages, if it calls functions of their order; `counts` are their numbers by topic.
    """

    text: bytes
    stored: bytes = b""
    is_whole: bool = True
    transforms: Sequence[FrameRow] = ()
    times: Sequence[MessageTimes] = ()
    counts: Mapping[str, int] = {}


class PastDataset(NamedTuple):
    """What may be read: for an agent with `permissions`, in the default graph of `graphs` (empty for all).

    `chosen` are the recordings that each `choice` of a selection has found.
    """

    graphs: tuple[str, ...]
    permissions: Permissions
    chosen: Mapping[str, frozenset[str]] = {}

    def includes(self, selection: PastSelection, recording: str) -> bool:
        """Whether messages of a recording may be selected."""
        if selection.recordings is not None and recording not in selection.recordings:
            return False
        return selection.choice is None or recording in self.chosen[selection.choice]


class PastSource(Protocol):
    """Reader of recorded messages. Called on the loop."""

    async def read(
        self,
        query: PastQuery,
        dataset: PastDataset,
        now: Interval,
        until: float,
        most: int | None = None,
    ) -> PastText:
        """Return the triples of the messages that a query selects, as far as they may be read.

        With a number `most`, about that many messages are read: those at the query's `end`, and always all on one side
        of some time. NOW() will be within `now`; `until` is the deadline (monotonic). Raises Problem 400 if there is no
        past to be read, and 503 for too much.
        """
        ...

    async def summarize(
        self, query: PastQuery, summary: SummaryQuery, dataset: PastDataset, until: float
    ) -> PastText | None:
        """Return the triples of summaries of the messages, None if messages must be read. Raises as `read` does."""
        ...
