"""Needs of a query: the constants by which its triple patterns can match live values. Pure.

Everything that does not require reading the robot is always in the dataset. Values (latest messages, parameter values
and properties) are read before a query with a triple pattern that can match one of their triples. Each pattern is
judged by its own constants alone, whatever joins and filters do with its matches, so adding a pattern to a query can
only add needs. Patterns that match only recorded messages (`past.py`) need nothing live.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from typing import NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from rosld.ontology.vocab import rdf
from rosld.server.sparql.ros_functions import AGE
from rosld.server.sparql.syntax.tree import Group, Iri, Pattern, Query, Variable

_TYPE = frozenset({rdf.type.value})


class Constants(NamedTuple):
    """Constants of a triple pattern; None matches anything.

    `graph` is the graph of the enclosing GRAPH, `document` the document of the subject. `type` is the class that the
    pattern requires.
    """

    graph: str | None = None
    document: str | None = None
    predicates: frozenset[str] | None = None
    type: str | None = None


class StatedTerms(NamedTuple):
    """Predicates of the value triples of a document and the classes of its nodes; None for any."""

    predicates: frozenset[str] | None = None
    classes: frozenset[str] | None = None

    def __or__(self, other: StatedTerms) -> StatedTerms:
        return StatedTerms(_union(self.predicates, other.predicates), _union(self.classes, other.classes))


def _union(one: frozenset[str] | None, other: frozenset[str] | None) -> frozenset[str] | None:
    return None if one is None or other is None else one | other


class Needs(Struct, frozen=True):
    """The values that a query can match: those that fit any of its `patterns`.

    `documents` are all IRIs, without fragment, in the query. `dataset` are the only graphs that it sees (FROM and FROM
    NAMED), None for all. `asks_graphs`: a GRAPH without patterns matches the names of graphs.
    """

    patterns: frozenset[Constants] = frozenset()
    documents: frozenset[str] = frozenset()
    dataset: frozenset[str] | None = None
    asks_graphs: bool = False

    def restrict_to(self, graphs: Collection[str]) -> Needs:
        """Return the needs of the same query over these graphs alone, which thereby count as named."""
        return replace(self, documents=self.documents.union(graphs), dataset=frozenset(graphs))

    def may_match(self, document: str, terms: StatedTerms) -> bool:
        """Whether a pattern can match value triples of a document with these terms."""
        if self.dataset is not None and document not in self.dataset:
            return False
        if self.asks_graphs and terms.predicates is None:  # the existence of the graph may depend on values
            return True
        return any(_may_match(pattern, document, terms) for pattern in self.patterns)

    def may_match_below(self, place: str, terms: StatedTerms) -> bool:
        """Whether a pattern can match triples with these terms in graphs whose names start with `place`."""
        if self.dataset is not None and not any(graph.startswith(place) for graph in self.dataset):
            return False
        graphs = (one for one in self.patterns if one.graph is None or one.graph.startswith(place))
        return any(_may_match(one._replace(graph=None, document=None), place, terms) for one in graphs)

    def __or__(self, other: Needs) -> Needs:
        dataset = _union(self.dataset, other.dataset)
        asks_graphs = self.asks_graphs or other.asks_graphs
        return Needs(self.patterns | other.patterns, self.documents | other.documents, dataset, asks_graphs)


def needs_of_documents(documents: Iterable[str]) -> Needs:
    """Return the needs of reading documents in full."""
    named = frozenset(documents)
    return Needs(frozenset(Constants(graph=document) for document in named), named, named)


def needs_of(query: Query, base: str, recorded: Collection[tuple[int, Pattern]] = ()) -> Needs:
    """Return the needs of a query, without its FROM; `base` is the prefix of the IRIs of this server's documents.

    `recorded` are the patterns that match only recorded messages, each with the `id` of its group.
    """
    groups = [*groups_within(query.where)]
    terms = [group.graph for group in groups]
    terms += (term for group in groups for each in group.patterns for term in (each.subject, each.object))
    named = {*query.constants, *(term.value for term in terms if isinstance(term, Iri))}
    patterns = frozenset(
        _constants(each, group) for group in groups for each in group.patterns if (id(group), each) not in recorded
    )
    if AGE in query.functions:
        patterns |= {Constants(graph=document_of(iri)) for iri in query.constants}
    documents = frozenset(document_of(iri) for iri in named if iri.startswith(base))
    asks_graphs = any(group.graph is not None and not (group.patterns or group.children) for group in groups)
    return Needs(patterns, documents, asks_graphs=asks_graphs)


def document_of(iri: str) -> str:
    """Return the IRI of the document that contains an IRI: the IRI without its fragment."""
    return iri.partition("#")[0]


def groups_within(group: Group) -> Iterator[Group]:
    """Yield a group and all groups within it; groups in filters match in the graph around them."""
    yield group
    for child in group.children:
        yield from groups_within(child)
    for inner in group.filters:
        is_elsewhere = group.graph is not None and inner.graph is None
        yield from groups_within(replace(inner, graph=group.graph) if is_elsewhere else inner)


def _constants(pattern: Pattern, group: Group) -> Constants:
    graph = group.graph.value if isinstance(group.graph, Iri) else None
    if matches_any_node(pattern, group.patterns):
        return Constants(graph)
    if pattern.repeated:  # later steps of the path match other nodes
        return Constants(graph, predicates=pattern.predicates)
    document = document_of(pattern.subject.value) if isinstance(pattern.subject, Iri) else None
    type = pattern.object.value if pattern.predicates == _TYPE and isinstance(pattern.object, Iri) else None
    return Constants(graph, document, pattern.predicates, type)


def matches_any_node(pattern: Pattern, patterns: Iterable[Pattern]) -> bool:
    """Whether a path may be empty between two variables that no other pattern of its group binds."""
    if not pattern.empty:
        return False
    bound = {term for each in patterns if not each.empty for term in (each.subject, each.object)}
    return all(isinstance(end, Variable) and end not in bound for end in (pattern.subject, pattern.object))


def _may_match(pattern: Constants, document: str, terms: StatedTerms) -> bool:
    graph, subject, predicates, type = pattern
    return (
        (graph is None or graph == document)
        and (subject is None or subject == document)
        and (predicates is None or terms.predicates is None or not terms.predicates.isdisjoint(predicates))
        and (type is None or terms.classes is None or type in terms.classes)
    )
