"""Tables of properties, one per class, from which both its RDF and its SHACL node shape are derived."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Generic, TypeAlias, TypeVar

from msgspec import Struct
from pyoxigraph import BlankNode, NamedNode, Triple

from rosld.ontology.kinds import TEXT, Kind
from rosld.ontology.triples import Statement
from rosld.ontology.urls import Space
from rosld.ontology.vocab import dcterms, ldp, rdf, rdfs, ros

T = TypeVar("T", contravariant=True)
V = TypeVar("V")
_Row: TypeAlias = tuple[NamedNode, Callable[..., Any], Callable[..., Any] | None, Any, bool]

SOURCE = (ldp.Resource, ldp.RDFSource)
CONTAINER_TYPES = (*SOURCE, ldp.Container, ldp.BasicContainer)


class Property(Struct, Generic[T], frozen=True):
    """Property of a class; `value` returns the value or values of an object, or is None for those added separately."""

    predicate: NamedNode
    kind: Kind[Any]
    value: Callable[[T], Any] | None
    counts: str
    is_many: bool = False

    @property
    def shacl(self) -> str:
        return f"[ sh:path {self.predicate} ; {self.counts}{self.kind.shacl} ]"


def one(predicate: NamedNode, kind: Kind[V], value: Callable[[T], V | None] | None = None) -> Property[T]:
    """Return a property with one value."""
    return Property(predicate, kind, value, "sh:minCount 1 ; sh:maxCount 1 ; ")


def optional(predicate: NamedNode, kind: Kind[V], value: Callable[[T], V | None] | None = None) -> Property[T]:
    """Return a property with at most one value."""
    return Property(predicate, kind, value, "sh:maxCount 1 ; ")


def many(
    predicate: NamedNode, kind: Kind[V], values: Callable[[T], Iterable[V]] | None = None, *, minimum: int = 0
) -> Property[T]:
    """Return a property with any number of values."""
    return Property(predicate, kind, values, f"sh:minCount {minimum} ; " if minimum else "", is_many=True)


class NodeShape(Generic[T]):
    """Table of the properties of a class.

    `types` are those of each node; the first is the target of the shape unless `target` defines another in Turtle.
    `more` are other constraints. `is_listed`: lists describe nodes too, with fewer properties. `required` are the
    properties that documents have, and lists omit. A name or a title is also the label, unless the table has one.
    """

    properties: tuple[Property[T], ...] = ()

    def __init__(
        self,
        name: str,
        label: str,
        *types: NamedNode,
        target: str | None = None,
        more: str | None = None,
        is_listed: bool = False,
        required: tuple[NamedNode, ...] = (),
    ) -> None:
        self.name = name
        self.label = label
        self._types = types
        self._target = target
        self._more = more
        self._is_listed = is_listed
        self._required = required
        self._rows: Sequence[_Row] = ()

    def with_properties(self, *properties: Property[T]) -> NodeShape[T]:
        by_predicate = {each.predicate: each for each in properties}
        named = by_predicate.get(dcterms.title) or by_predicate.get(ros.name)
        if named is not None and rdfs.label not in by_predicate:
            properties = (Property(rdfs.label, TEXT, named.value, named.counts), *properties)
        self.properties = properties
        self._rows = [
            (each.predicate, each.value, each.kind.term, each.kind.url, each.is_many)
            for each in properties
            if each.value
        ]
        return self

    def triples(self, node: NamedNode | BlankNode, thing: T, space: Space | None, *more: Statement) -> list[Triple]:
        """Return the description of an object; `more` are statements of properties without a function.

        Only links to resources need `space`.
        """
        triples = [Triple(node, rdf.type, kind) for kind in self._types]
        for predicate, get, term, url_of, is_many in self._rows:
            found = get(thing)
            for each in found if is_many else () if found is None else (found,):
                value = term(each) if term else NamedNode(url_of(space, each) if url_of else node.value + each)
                triples.append(Triple(node, predicate, value))
        for predicate, value in more:
            if value is not None:
                triples.append(Triple(node, predicate, value))
        return triples

    def turtle(self) -> str:
        """Return the SHACL shape, with prefixed names."""
        target = self._target if self._target is not None else f"sh:targetClass {self._types[0]}"
        ignored = "rdf:type ros:briefValue rdfs:seeAlso" if self._is_listed else "rdf:type"
        closed = f"sh:closed true ; sh:ignoredProperties ( {ignored} )"
        parts = ["a sh:NodeShape", f'rdfs:label "{self.label}"@en', target, self._more, closed]
        if self._required:
            properties = " , ".join(f"[ sh:path {each} ; sh:minCount 1 ]" for each in self._required)
            parts.append(f"sh:or ( [ sh:not [ sh:class {ldp.RDFSource} ] ] [ sh:property {properties} ] )")
        elif len(self._types) > 1 and not self._is_listed:
            kind = f"sh:minCount 1 ; sh:nodeKind sh:IRI ; sh:hasValue {self._types[-1]}"
            parts.append(f"sh:property [ sh:path rdf:type ; {kind} ]")
        parts += (f"sh:property {each.shacl}" for each in self.properties)
        return f"<#{self.name}> {' ; '.join(filter(None, parts))} ."
