"""From the patterns of a query to what it needs, as narrow as is safe. Pure.

What is not always in the dataset are the *live* graphs: of topics and parameters with their values, of resources whose
getters are called, of recorded messages. A query needs those live triples that take part in a match of one of its
groups: the value of a group (its solutions) is determined by the matches of its own triple patterns and by the values
of the groups within it (SPARQL 1.1, 18.6), so if for every group, however deep, all its matches are there, every answer
is the same as over everything. So groups are looked at one by one, and nothing passes from one to another: what stands
in OPTIONAL, MINUS, EXISTS, UNION or a subquery is narrowed by its own patterns alone. VALUES, BIND and FILTER narrow
nothing; what they name is looked at in addition, as if a pattern had named it.

Within one group patterns narrow each other where they must match in one graph. GRAPH says so outright. Without it,
`VocabularyView` tells what holds of the graphs that the server itself makes, each of a resource D:

1. the subject of a live triple of D's graph is D, a fragment of it, or a blank node of its own;
2. no other graph has triples about such nodes;
3. some predicates (`ros:latest`, fields, lists) *stay*: the object, if it is a node that has triples, is D's as well.

Let a pattern match a live triple of D. Every pattern with the same subject then matches in D's graph too (1, 2), and by
3 so does every pattern whose subject a predicate that stays leads to or comes from. Patterns so connected are a
`LivePart`, and whatever any of them says of its graph (its resource by a constant, the message type by a field or a
class, the kind by a class or predicate) holds for D. Where a part's patterns exclude D, nothing of D is needed for that
part.

Clients may break 2 and 3 in graphs of their own: with a triple about a node of D, or that leads to one. Such a match
matters only where it is of a pattern that the narrowing rests on, so `Needs.rests_on` tells the predicates and classes
of these, and `mentions.py` finds the resources of which clients say so: these are needed in addition.

A path is a chain of patterns with variables between; what it repeats is a pattern that may match along any of its
predicates. It connects where all of these stay, and else stands alone. A path that may be empty matches every node
there is, unless another pattern says what its ends are: such a query needs everything.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from types import MappingProxyType

from rosld.ontology.vocab import rdf
from rosld.server.sparql.needs import Demand, Needs, remove_covered
from rosld.server.sparql.syntax.tree import Group, Iri, Pattern, Query, Term, Variable
from rosld.server.sparql.vocabulary_view import (
    ANY,
    COMPLEX,
    NEITHER,
    UNKNOWN_NODE,
    LiveKinds,
    NodeMeaning,
    VocabularyView,
    document_of,
)


def needs_of(
    query: Query, terms: VocabularyView, recorded: Mapping[int, frozenset[str]] = MappingProxyType({})
) -> Needs:
    """What a query needs, its FROM aside.

    `recorded` are the variables that stand for nodes of recorded messages, by the `id` of the group they are in: of
    these nothing is live.
    """
    parts = [
        PartNeeds(part, terms)
        for group in _groups(query.where)
        for part in _parts(group, terms)
        if not _is_recorded(part, recorded.get(id(group)))
    ]
    demands = [demand for part in parts if (demand := part.demand)]
    if any(demand.is_anything for demand in demands):
        demands.extend(_demands_of_constants(query.constants, terms))
    unread = reduce(LiveKinds.__or__, (part.unread for part in parts), NEITHER)
    return Needs(
        tuple(remove_covered(demands)),
        frozenset(document_of(iri) for iri in _documents(query) if terms.is_here(iri)),
        frozenset().union(terms.resource_terms(query.constants), *(part.terms for part in parts)),
        frozenset().union(*(part.rests_on for part in parts)),
        unread.resources,
        unread.records,
        unread.parameters,
        frozenset(group.graph.value for group in _groups(query.where) if isinstance(group.graph, Iri)),
    )


def _groups(group: Group) -> Iterator[Group]:
    """A group and all within it. Those of filters are matched in the graph around them."""
    yield group
    for child in group.children:
        yield from _groups(child)
    for inner in group.filters:
        is_elsewhere = group.graph is not None and inner.graph is None
        yield from _groups(replace(inner, graph=group.graph) if is_elsewhere else inner)


def _is_recorded(part: LivePart, recorded: frozenset[str] | None) -> bool:
    """Whether patterns are about nodes of recorded messages."""
    subjects = (each.subject for each in part.patterns)
    return recorded is not None and any(isinstance(each, Variable) and each.name in recorded for each in subjects)


def _documents(query: Query) -> Iterator[str]:
    """All IRIs that may be those of resources."""
    yield from query.constants
    for group in _groups(query.where):
        for term in (group.graph, *(term for each in group.patterns for term in (each.subject, each.object))):
            if isinstance(term, Iri):
                yield term.value


def _demands_of_constants(constants: Iterable[str], terms: VocabularyView) -> Iterator[Demand]:
    """The demands for what is named outside of patterns: where nothing else says so, it is looked at all the same."""
    for iri in constants:
        named = terms.type_named(iri)
        if named is not None:
            yield Demand(types=frozenset({named}))
        elif terms.is_here(iri):
            yield Demand(frozenset({document_of(iri)}), parameters=True)


@dataclass(eq=False, slots=True)
class LivePart:
    """Patterns that match in one graph if any of them matches live values; `graphs` are the only ones it can be.

    `links` are those that connect it. `free`: it matches any node. `in_one`: it matches within one graph in any case;
    `is_named`: that is a constant.
    """

    graphs: frozenset[str] | None = None
    patterns: list[Pattern] = field(default_factory=list)
    links: list[Pattern] = field(default_factory=list)
    free: bool = False
    in_one: bool = False
    is_named: bool = False


class PartNeeds:
    """What a part needs.

    `demand` are the values of topics and parameters. `terms` are the classes and predicates by which it names resources
    whose getters are called. `unread` is what it could match though it names none of it. `rests_on` are the predicates
    and classes that narrow it, if they are said by the server alone.
    """

    def __init__(self, part: LivePart, vocabulary: VocabularyView) -> None:
        self._part = part
        self._vocabulary = vocabulary
        self._sayings = [vocabulary.subject_meaning(each) for each in part.patterns]
        self._said = reduce(NodeMeaning.combine, self._sayings, UNKNOWN_NODE)
        self._live = ANY if part.free else self._of(self._resources()) & self._said.live
        self.demand = self._demand()
        self.terms = self._named_by()
        self.unread = self._left_unread()
        self.rests_on = self._narrowed_by()

    def _resources(self) -> set[Term]:
        """The subjects that are resources themselves."""
        together = zip(self._part.patterns, self._sayings, strict=True)
        return {each.subject for each, said in together if self._vocabulary.is_of_resource(each, said)}

    def _of(self, resources: Collection[Term]) -> LiveKinds:
        """The kinds of live values that its patterns can match, these being resources themselves."""
        found = (self._vocabulary.live_kinds(each, each.subject in resources) for each in self._part.patterns)
        return reduce(LiveKinds.__or__, found, NEITHER)

    def _demand(self) -> Demand | None:
        part, live = self._part, self._live
        if part.is_named and any(map(self._vocabulary.tells_of_members, part.graphs or ())):
            return Demand(part.graphs, parameters=True, messages=False)  # they say of their members what those say
        if not (live.messages or live.parameters):
            return None
        return Demand(part.graphs, self._said.types, live.messages, live.parameters)

    def _named_by(self) -> frozenset[str]:
        if self._part.graphs is not None or not self._live.resources:
            return frozenset()
        known = self._vocabulary
        return frozenset().union(*(known.resource_terms(known.defining_terms(each)) for each in self._part.patterns))

    def _left_unread(self) -> LiveKinds:
        part, known = self._part, self._vocabulary
        if part.is_named:
            return NEITHER
        # A complex resource tells the values of its members, too: who names a member has not named that.
        tells = any(each.predicates is None or rdf.value.value in each.predicates for each in part.patterns)
        is_left = tells and self.terms.isdisjoint(COMPLEX)
        if part.graphs is not None:
            of_resources = is_left and any(map(known.is_of_resources, part.graphs))
            of_parameters = part.in_one and any(map(known.is_of_parameters, part.graphs))
            return LiveKinds(resources=of_resources, parameters=of_parameters)
        is_covered = not part.free and any(map(known.names_resources, part.patterns))
        resources = self._live.resources and (is_left or not is_covered)
        return self._live._replace(resources=resources, parameters=part.in_one and self._is_of_trees)

    @property
    def _is_of_trees(self) -> bool:
        """Whether it can match what trees of parameters say of their members."""
        return self._said.live.parameters and all(map(self._vocabulary.is_of_server, self._part.patterns))

    def _narrowed_by(self) -> frozenset[str]:
        part = self._part
        if part.in_one or len(part.patterns) < 2 or not any(self._of(())):
            return frozenset()
        saying = (each for each, said in zip(part.patterns, self._sayings, strict=True) if said != UNKNOWN_NODE)
        return frozenset().union(*map(self._vocabulary.defining_terms, (*saying, *part.links)))


def _parts(group: Group, terms: VocabularyView) -> Iterator[LivePart]:
    """The patterns of a group, by the graphs they must match in."""
    free = [each for each in group.patterns if is_free(each, group.patterns)]
    bound = [each for each in group.patterns if each not in free]
    if group.graph is not None:
        names = frozenset({group.graph.value}) if isinstance(group.graph, Iri) else None
        for pattern in free:
            yield LivePart(names, [pattern], free=True, in_one=True, is_named=names is not None)
        subjects = (frozenset({document_of(each.subject.value)}) for each in bound if isinstance(each.subject, Iri))
        yield LivePart(_common((names, *subjects)), bound, in_one=True, is_named=names is not None)
        return
    for pattern in free:
        yield LivePart(None, [pattern], free=True)
    staying = [each for each in bound if not each.repeated or terms.stays_in_graph(each)]
    for pattern in bound:
        if pattern not in staying:
            yield LivePart(None, [pattern])
    yield from _connect(staying, terms)


def _connect(patterns: Sequence[Pattern], terms: VocabularyView) -> Iterator[LivePart]:
    """The patterns by what they are about: a union-find over their subjects, constants going by their documents."""
    rooted = _variables_with_triples(patterns)
    leaders: dict[str, str] = {}

    def leader(key: str) -> str:
        above = leaders.setdefault(key, key)
        return key if above == key else leader(above)

    links = [
        each for each in patterns if terms.stays_in_graph(each) and (each.object in rooted or _is_node(each.object))
    ]
    for pattern in links:
        leaders[leader(_key(pattern.object))] = leader(_key(pattern.subject))
    parts: dict[str, LivePart] = {}
    for pattern in patterns:
        part = parts.setdefault(leader(_key(pattern.subject)), LivePart())
        part.patterns.append(pattern)
        if pattern in links:
            part.links.append(pattern)
    for key in leaders:
        if key[0] == "<":
            part = parts[leader(key)]
            part.graphs = _common((part.graphs, frozenset({key[1:]})))
    yield from parts.values()


def _variables_with_triples(patterns: Sequence[Pattern]) -> set[Term]:
    """The variables for nodes that have triples of their own: no literals, nor the empty list that all graphs share."""
    rooted: set[Term] = {each.subject for each in patterns if not each.empty and isinstance(each.subject, Variable)}
    empties = [each for each in patterns if each.empty and isinstance(each.subject, Variable)]
    for _ in empties:  # from a node without triples no path, empty or not, leads to one with triples
        rooted.update(each.subject for each in empties if each.object in rooted)
    return rooted


def is_free(pattern: Pattern, patterns: Sequence[Pattern]) -> bool:
    """Whether it may be empty between what no other pattern binds, and so match any node that there is."""
    if not pattern.empty:
        return False
    bound = {term for each in patterns if not each.empty for term in (each.subject, each.object)}
    return not any(isinstance(end, Variable) and end in bound for end in (pattern.subject, pattern.object))


def _common(graphs: Iterable[frozenset[str] | None]) -> frozenset[str] | None:
    """The graphs that all allow. Where they exclude each other nothing live matches: to be safe, those of either."""
    found: frozenset[str] | None = None
    for each in graphs:
        if each is not None:
            found = each if found is None else (found & each) or (found | each)
    return found


def _is_node(term: Term) -> bool:
    """Whether it is a constant that names a node of one document."""
    return isinstance(term, Iri) and term.value != _NIL


_NIL = rdf.nil.value


def _key(term: Term) -> str:
    if isinstance(term, Variable):
        return "?" + term.name
    return "<" + document_of(term.value) if isinstance(term, Iri) and term.value != _NIL else "!"
