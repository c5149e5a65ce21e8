"""From the patterns of a query to what it needs, as narrow as is safe. Pure.

It rests on how live values stand in the dataset:

- the graph of a live resource is named by its URL, and the subjects of its triples are that URL, fragments of it, or
  blank nodes of its own; so what is said of one node, and of the nodes its fields lead to, stands in one graph;
- the predicates of fields, and the classes of messages, belong to one message type each.

So the patterns about one node, and about the nodes it leads to, narrow each other: a topic matters where it fits all.
Values that are left out because they do not would have been dropped by the query's joins. What stands within OPTIONAL,
MINUS, EXISTS or another group is narrowed only by what certainly holds of the variables that occur there too, whenever
that group is looked at; a subquery is narrowed by nothing around it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from rosld.server.sparql.needs import Demand, Needs, largest
from rosld.server.sparql.patterns import Group, Iri, Pattern, Reading, Term, Variable
from rosld.server.sparql.terms import BOTH, NEITHER, UNKNOWN, Said, Terms, document


def needs(reading: Reading, terms: Terms) -> Needs:
    """What a query needs, its FROM aside."""
    search = _Search(terms)
    search.group(reading.where, {})
    return Needs(tuple(largest(search.demands)), frozenset(search.documents), frozenset(search.terms))


class _Search:
    """Collects the demands of a query, group by group."""

    def __init__(self, terms: Terms) -> None:
        self._terms = terms
        self.demands: list[Demand] = []
        self.documents: set[str] = set()
        self.terms: set[str] = set()

    def group(self, group: Group, around: Mapping[str, Said]) -> None:
        """The demands of a group and of those within; `around` is what certainly holds of variables outside."""
        if group.scoped:
            around = {}
        facts = Facts(self._terms, group.graph, group.patterns, group.bound, around)
        self._mention(group)
        for part in facts.parts:
            self._demand(part, facts)
        for pattern in group.patterns:
            self._demand_apart(pattern, group)
            self._name(pattern, group, facts)
        for child in group.children:
            before = Facts(self._terms, group.graph, group.patterns[: child.after], child.bound, around)
            self.group(child.group, before.variables)
        for inner in group.filters:
            placed = inner if inner.graph is not None else replace(inner, graph=group.graph)
            self.group(placed, facts.variables)

    def _mention(self, group: Group) -> None:
        for term in (group.graph, *(pattern.subject for pattern in group.patterns)):
            if isinstance(term, Iri):
                self.documents.add(document(term.value))
        for values in group.bound.values():
            self.documents.update(map(document, values))

    def _name(self, pattern: Pattern, group: Group, facts: Facts) -> None:
        """The terms that name resources, unless the one that is meant is named itself."""
        said = facts.subject(pattern.subject)
        if not isinstance(group.graph, Iri) and not isinstance(pattern.subject, Iri) and said.graphs is None:
            self.terms |= self._terms.of_resources(pattern, said)

    def _demand(self, part: Part, facts: Facts) -> None:
        live = NEITHER
        for pattern in part.patterns:
            live = live | self._terms.live(pattern, facts.subject(pattern.subject))
        if any(self._terms.only_live(pattern) for pattern in part.patterns):
            live = live._replace(parameters=False)
        if any(live):
            types = frozenset() if live.parameters else part.said.types
            self.demands.append(Demand(part.said.graphs, types, live.messages, live.parameters))

    def _demand_apart(self, pattern: Pattern, group: Group) -> None:
        """The demands of a path whose matches stand in no one graph, or that may be empty between any nodes."""
        live = NEITHER
        graphs = frozenset({group.graph.value}) if isinstance(group.graph, Iri) else None
        if _is_free(pattern, group):
            live = BOTH
            if group.graph is None:
                graphs = _found_in(pattern, group, self._terms)
        elif is_loose(pattern, self._terms):
            live = self._terms.live(pattern, UNKNOWN)
        if any(live):
            self.demands.append(Demand(graphs, frozenset(), *live))


def is_loose(pattern: Pattern, terms: Terms) -> bool:
    """Whether it may match along several graphs, so that its ends say nothing of each other."""
    return pattern.repeated and (pattern.predicates is None or not all(map(terms.stays, pattern.predicates)))


def _is_free(pattern: Pattern, group: Group) -> bool:
    """Whether it may be empty between what no other pattern binds: the store matches any term that it finds in a graph.

    (With every node, between two variables; SPARQL 1.1, 18.4, would match a constant that is nowhere, too.)
    """
    if not pattern.empty:
        return False
    ends = {term.name for term in (pattern.subject, pattern.object) if isinstance(term, Variable)}
    others = {
        term.name
        for other in group.patterns
        if not other.empty
        for term in (other.subject, other.object)
        if isinstance(term, Variable)
    }
    return not ends & others


def _found_in(pattern: Pattern, group: Group, terms: Terms) -> frozenset[str] | None:
    """The only live documents that an end of the path can be found in; None where it can be any."""
    for term in (pattern.subject, pattern.object):
        iris = group.bound.get(term.name) if isinstance(term, Variable) else None
        if isinstance(term, Iri):
            iris = frozenset({term.value})
        if iris is not None and not any(map(terms.is_everywhere, iris)):
            return frozenset(map(document, iris))
    return None


@dataclass(eq=False)
class Part:
    """Patterns whose live matches all stand in one graph, and what is known of it."""

    said: Said = UNKNOWN
    patterns: list[Pattern] = field(default_factory=list)


class Facts:
    """What patterns that hold together say of their nodes.

    Nodes are known by keys: `?x` for a variable, `<D` for all constants of document D. Nodes that must stand in one
    graph have one leader (a union-find), and one `Part`.
    """

    def __init__(
        self,
        terms: Terms,
        graph: Term | None,
        patterns: Iterable[Pattern],
        bound: Mapping[str, frozenset[str]],
        around: Mapping[str, Said],
    ) -> None:
        self._terms = terms
        self._graph = _key(graph)
        self._leaders: dict[str, str] = {}
        self._subjects: dict[str, Said] = {}
        self._rooted: set[str | None] = set()
        held = [pattern for pattern in patterns if not is_loose(pattern, terms)]
        self._note_nodes(held, bound)
        for pattern in held:
            self._link(pattern)
        self._parts: dict[str, Part] = {}
        self._gather(held, bound, around)

    @property
    def parts(self) -> Iterable[Part]:
        """The patterns, by the graph they must stand in."""
        return self._parts.values()

    @property
    def variables(self) -> Mapping[str, Said]:
        """What certainly holds of each variable that stands for a node."""
        return {key[1:]: self._all(key) for key in self._leaders if key[0] == "?"}

    def subject(self, term: Term) -> Said:
        """What is known of a term as the subject of a pattern."""
        if isinstance(term, Iri):
            return UNKNOWN if "#" in term.value else Said(resource=True)
        return self._subjects.get(_key(term) or "", UNKNOWN)

    def _note_nodes(self, patterns: Sequence[Pattern], bound: Mapping[str, frozenset[str]]) -> None:
        """The nodes; those with triples of their own are `rooted`: no literals, nor the empty list that all share."""
        keys = [self._graph, *(_key(one.subject) for one in patterns), *("?" + name for name in bound)]
        self._leaders.update((key, key) for key in keys if key)
        self._rooted.update(_key(one.subject) for one in patterns if not one.empty)
        empties = [one for one in patterns if one.empty]
        for _ in empties:  # from a node without triples no path, empty or not, leads to one with triples
            self._rooted.update(_key(one.subject) for one in empties if _key(one.object) in self._rooted)

    def _link(self, pattern: Pattern) -> None:
        """Nodes that a live match of the pattern puts into one graph."""
        subject, place, object = _key(pattern.subject), self._place(pattern), _key(pattern.object)
        if subject and self._terms.only_live(pattern):
            self._leaders[self._leader(subject)] = self._leader(place)
        if object is None or pattern.predicates is None or not all(map(self._terms.stays, pattern.predicates)):
            return
        if object in self._rooted or self._terms.owns_object(pattern):
            self._leaders[self._leader(object)] = self._leader(place)

    def _place(self, pattern: Pattern) -> str:
        """The node whose graph a match stands in: the GRAPH around it, or else its subject."""
        return self._graph or _key(pattern.subject) or _LITERAL

    def _leader(self, key: str) -> str:
        leader = self._leaders.setdefault(key, key)
        while leader != self._leaders[leader]:
            leader = self._leaders[leader]
        return leader

    def _part(self, key: str) -> Part:
        return self._parts.setdefault(self._leader(key), Part())

    def _gather(
        self, patterns: Iterable[Pattern], bound: Mapping[str, frozenset[str]], around: Mapping[str, Said]
    ) -> None:
        for key in tuple(self._leaders):
            said = Said(graphs=frozenset({key[1:]})) if key[0] == "<" else around.get(key[1:], UNKNOWN)
            if key[0] == "?" and key[1:] in bound:
                said = said.also(Said(graphs=frozenset(map(document, bound[key[1:]]))))
            self._subjects[key] = said
            self._tell(self._part(key), said)
        for pattern in patterns:
            said, key, part = (
                self._terms.says(pattern),
                _key(pattern.subject) or _LITERAL,
                self._part(self._place(pattern)),
            )
            self._subjects[key] = self._subjects.get(key, UNKNOWN).also(said)
            part.patterns.append(pattern)
            self._tell(part, said)

    def _tell(self, part: Part, said: Said) -> None:
        """Of what is said of a node, only where it stands holds for all that stands there."""
        part.said = part.said.also(Said(graphs=said.graphs, types=said.types))

    def _all(self, key: str) -> Said:
        return self._subjects.get(key, UNKNOWN).also(self._part(key).said)


_LITERAL = "!"


def _key(term: Term | None) -> str | None:
    if isinstance(term, Variable):
        return "?" + term.name
    return "<" + document(term.value) if isinstance(term, Iri) else None
