"""Limits: SHACL shapes that bound writes, by the type of a message or by the resource.

A shape limits its targets (SHACL 2.1.3): `sh:targetClass` is the class of a message type and applies wherever such a
message is written, including nested ones; `sh:targetNode` is the URL of a resource. Messages are validated as if they
were lifted without elision; only the fields that a limit names are read.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from functools import lru_cache
from itertools import islice
from typing import TypeAlias

from msgspec import Struct, field
from msgspec.structs import replace
from pyoxigraph import BlankNode, NamedNode, Triple

from rosld.adapters.model import Array, Message, MessageSchema, Nested, Primitive
from rosld.ontology.body import Term, parse_body
from rosld.ontology.lift import TYPES, LiftSettings, partial_lifter
from rosld.ontology.urls import Space
from rosld.ontology.violations import Violation
from rosld.ontology.vocab import rdf, rdfs, sh
from rosld.shapes.limit_parts import (
    NO_DEMAND,
    Demand,
    InexpressibleError,
    LimitPart,
    Place,
    ResourcePlace,
    ValuePlace,
    limit_part,
)
from rosld.shapes.shapes_graph import MAX_VIOLATIONS, NodeShape, ShapesGraph, compile_shape, conjunction
from rosld.shapes.terms import TripleView, View
from rosld.shapes.value import UNBOUNDED, Bounds, merge_bounds

Check: TypeAlias = Callable[[Message, str, str], tuple[Violation, ...]]
"""Function that returns the violations of a message lifted as the node (`#message`) of a document (its URL)."""

_WHOLE = 1 << 62
_KINDS = ("resources", "topics", "services", "parameters", "nodes")
_TYPE_NAME = re.compile(r"[A-Za-z]\w*/(?:msg|srv|action)/[A-Za-z]\w*", re.ASCII)


def read_limits(data: bytes, base: str, document: str | None = None) -> tuple[Triple, ...]:
    """Return the shapes graph of a Turtle file, with relative IRIs resolved against the server's base URL.

    Its own names (`<#speed>`) are those of `document`, which shows it. Raises BodyError for invalid Turtle, ValueError
    for triple terms.
    """
    body = parse_body(data, "text/turtle", base)
    triples: list[Triple] = []
    for subject, properties in body.subjects.items():
        for predicate, objects in properties.items():
            for each in objects:
                if isinstance(subject, Triple) or isinstance(each, Triple):
                    raise ValueError("a shapes graph has no triple terms")
                triples.append(Triple(subject, predicate, each))
    return tuple(triples if document is None else (_rename(triple, f"{base}#", f"{document}#") for triple in triples))


def _rename(triple: Triple, old: str, new: str) -> Triple:
    """Return a triple with the prefix `old` of its IRIs replaced by `new`."""
    subject, value = triple.subject, triple.object
    if isinstance(subject, NamedNode) and subject.value.startswith(old):
        subject = NamedNode(new + subject.value[len(old) :])
    if isinstance(value, NamedNode) and value.value.startswith(old):
        value = NamedNode(new + value.value[len(old) :])
    return Triple(subject, triple.predicate, value)


class Limits(Struct, frozen=True, eq=False):
    """All limits in force. `graph` is the union of the shapes graphs.

    `by_class`: the limits on messages by the IRI of their class. `by_url`: those on resources.
    """

    graph: tuple[Triple, ...] = ()
    by_class: Mapping[str, NodeShape] = field(default_factory=dict)
    by_url: Mapping[str, NodeShape] = field(default_factory=dict)
    types: str = TYPES

    @classmethod
    def from_graphs(cls, graphs: Sequence[Sequence[Triple]], space: Space) -> Limits:
        """Return the limits of shapes graphs; blank nodes of different graphs are different.

        Raises ValueError with a sentence for a malformed shape, for a shape without a target, and for a target that is
        neither the class of a message type nor the URL of a resource of `space`.
        """
        by_class: dict[str, list[NodeShape]] = {}
        by_url: dict[str, list[NodeShape]] = {}
        for graph in graphs:
            shapes = ShapesGraph(graph)
            targeted = set()
            for node, kind, target in _targets(graph, shapes):
                targeted.add(node)
                name, shape = shapes.name(node), compile_shape(shapes, node)
                if kind == sh.targetClass:
                    by_class.setdefault(_class(name, target, shape, space), []).append(shape)
                else:
                    by_url.setdefault(_url(name, kind, target, space), []).append(shape)
            for root in shapes.roots():
                if root not in targeted:
                    raise ValueError(
                        f"{shapes.name(root)} limits nothing: give it a sh:targetNode (the URL of a resource) or a "
                        "sh:targetClass (the class of a message type)"
                    )
        return cls(
            tuple(_union(graphs)),
            {name: conjunction(found) for name, found in by_class.items()},
            {url: conjunction(found) for url, found in by_url.items()},
            space.types,
        )

    def __bool__(self) -> bool:
        """Whether there are limits."""
        return bool(self.by_class or self.by_url)

    def message(self, schema: MessageSchema) -> Check | None:
        """Return the validator of messages of a type; None without limits on it or nested types."""
        return _check(self, schema) if self.by_class else None

    def resource(self, url: str) -> NodeShape | None:
        """Return the validator of triples of the resource at a URL (the focus node); None without limits."""
        return self.by_url.get(url)

    def bounds_of_resource(self, url: str) -> Bounds:
        """Return the bounds on the scalar that is a resource's value."""
        shape = self.by_url.get(url)
        return UNBOUNDED if shape is None else shape.within.get((rdf.value,), UNBOUNDED)

    def bounds_of_message(self, schema: MessageSchema) -> Mapping[str, Bounds]:
        """Return the bounds on single scalars by dotted path; in arrays of messages they apply to each element.

        For example, `transforms.transform.translation.x` is that of every transform.
        """
        return _bounds(self, schema) if self.by_class else {}

    def bounds_of_value(self, url: str, predicate: NamedNode, schema: MessageSchema) -> Mapping[str, Bounds]:
        """Return the bounds on scalars of the message that is a resource's value of a predicate."""
        shape, space = self.by_url.get(url), Space("http://0/", self.types)
        found = {} if shape is None else {way[1:]: each for way, each in shape.within.items() if way[0] == predicate}
        paths = {way: _dotted_path(schema, schema.ref.name, way, space) for way in found if way}
        return {path: found[way] for way, path in paths.items() if path is not None}

    def demand_of_message(self, schema: MessageSchema) -> Demand:
        """Return the demand on messages of a type, and on nested ones."""
        demand, space = Demand(tuple(self.bounds_of_message(schema).items())), Space("http://0/", self.types)
        for name in schema.types:
            shape = self.by_class.get(space.class_of(name))
            if shape is not None and not shape.is_bounds:
                parts = _parts(shape, ValuePlace.message(schema, name), space)
                demand &= Demand(is_all=parts is not None, type_parts=[(name, part) for part in parts or ()])
        return demand

    def demand_of_value(
        self, url: str, predicate: NamedNode, schema: MessageSchema, scalar: str | None = None
    ) -> Demand:
        """Return the demand on the message that is a resource's value of a predicate, or on its single `scalar`."""
        shape = self.by_url.get(url)
        if shape is None:
            return NO_DEMAND
        bounds = self.bounds_of_value(url, predicate, schema)
        if scalar is not None and (predicate,) in shape.within:
            bounds = {scalar: shape.within[predicate,]}
        about = [way for way in shape.within if way[0] == predicate]
        demand = Demand(tuple(bounds.items()))
        if shape.is_bounds and len(about) == len(bounds):
            return demand
        place = ValuePlace.of_field(schema, scalar)
        return demand & _of_parts(shape, predicate, place, self.types, scalar or "")

    def demand_of_scalar(self, url: str, predicate: NamedNode, place: ValuePlace | None = None) -> Demand:
        """Return the demand on the scalar of kind `place` that is a resource's value of a predicate."""
        shape = self.by_url.get(url)
        if shape is None:
            return NO_DEMAND
        found = {way: bounds for way, bounds in shape.within.items() if way[0] == predicate}
        bounds = [("", each) for way, each in found.items() if len(way) == 1]
        if shape.is_bounds and len(bounds) == len(found):
            return Demand(tuple(bounds))
        return Demand(tuple(bounds)) & _of_parts(shape, predicate, place, self.types, "")


def _parts(shape: NodeShape, place: Place, space: Space) -> list[LimitPart] | None:
    """Return the parts of a shape for accepted RDF; None if one cannot be expressed."""
    try:
        parts = [limit_part(each, place, space) for each in shape.sources]
    except InexpressibleError:
        return None
    return [each for each in parts if not each.is_empty]


def _of_parts(shape: NodeShape, predicate: NamedNode, place: ValuePlace | None, types: str, path: str) -> Demand:
    """Return the demand of a limit on a resource for its value, at a dotted path."""
    parts = _parts(shape, ResourcePlace(predicate, place), Space("http://0/", types))
    return Demand(is_all=parts is not None, value_parts=[(path, part.of_value()) for part in parts or ()])


def _targets(graph: Sequence[Triple], shapes: ShapesGraph) -> Iterator[tuple[NamedNode | BlankNode, NamedNode, Term]]:
    """Yield each target, including implicit ones of shapes that are classes (SHACL 2.1.3.3)."""
    yield from shapes.targets()
    classes = {triple.subject for triple in graph if triple.predicate == rdf.type and triple.object == rdfs.Class}
    for root in shapes.roots():
        if root in classes:
            yield root, sh.targetClass, root


def _class(name: str, target: Term, shape: NodeShape, space: Space) -> str:
    iri = target.value if isinstance(target, NamedNode) else str(target)
    if not iri.startswith(space.types) or not _TYPE_NAME.fullmatch(iri[len(space.types) :]):
        raise ValueError(
            f"{name} limits the class <{iri}>, which is not a message type: it should look like "
            f"<{space.types}geometry_msgs/msg/Twist>"
        )
    for path in shape.paths or ():
        if path.value.startswith(space.types) and not path.value.startswith(iri + "#"):
            raise ValueError(f"{name} limits <{iri}>, but is about <{path.value}>, which is not a field of that type")
    return iri


def _url(name: str, kind: NamedNode, target: Term, space: Space) -> str:
    if kind != sh.targetNode:
        raise ValueError(
            f"{name} has a sh:{kind.value[len(sh.iri) :]}: name what it limits by sh:targetNode (the URL of a resource)"
            " or sh:targetClass (the class of a message type)"
        )
    url = target.value if isinstance(target, NamedNode) else str(target)
    location = space.location(url) if isinstance(target, NamedNode) else None
    if location is None or location.kind not in _KINDS or "#" in url or "?" in url:
        raise ValueError(
            f"{name} limits <{url}>, which is not a resource, topic, service, parameter or node of <{space.base}>: "
            "write a relative IRI, such as <resources/aircraft/engine/speed>"
        )
    return url


def _union(graphs: Sequence[Sequence[Triple]]) -> Iterator[Triple]:
    """Yield the triples of all graphs, with distinct blank nodes."""
    for number, graph in enumerate(graphs):

        def apart(term: Term, prefix: str = f"g{number}-") -> Term:
            return BlankNode(prefix + term.value) if isinstance(term, BlankNode) else term

        for triple in graph:
            yield Triple(apart(triple.subject), triple.predicate, apart(triple.object))  # type: ignore[arg-type]


# Messages


@lru_cache(maxsize=1024)
def _check(limits: Limits, schema: MessageSchema) -> Check | None:
    names = {name: Space("http://0/", limits.types).class_of(name) for name in schema.types}
    shapes = {name: limits.by_class[iri] for name, iri in names.items() if iri in limits.by_class}
    return _MessageCheck(schema, shapes, limits).check if shapes else None


def _predicates(graph: Iterable[Triple]) -> frozenset[str] | None:
    """Return predicates that include all those that shapes read; None if they may read any."""
    used = {triple.predicate for triple in graph}
    if sh.closed in used:
        return None
    named = {triple.object.value for triple in graph if isinstance(triple.object, NamedNode)}
    return frozenset(named | {rdf.type.value}) if sh.class_ in used else frozenset(named)


class _MessageCheck:
    """Validator of the messages of one schema by the shapes of its types."""

    def __init__(self, schema: MessageSchema, shapes: Mapping[str, NodeShape], limits: Limits) -> None:
        self._schema = schema
        self._shapes = shapes
        self._space = Space("http://0/", limits.types)
        self._lifter = partial_lifter(schema, LiftSettings(limits.types, _WHOLE), _predicates(limits.graph))
        reaching = self._reaching()
        self._steps = {name: self._inner(name, reaching | shapes.keys()) for name in reaching}
        self._strange = tuple(self._strangers())

    def check(self, message: Message, document: str, node: str) -> tuple[Violation, ...]:
        """Return the violations of a message. A limit on an unknown field is a mistake, which permits no message."""
        if self._strange:
            return self._strange
        view = TripleView(self._lifter.triples(message, document, node))
        return tuple(islice(self._broken(self._schema.ref.name, message, document + node, "", view), MAX_VIOLATIONS))

    def _broken(self, name: str, message: Message, node: str, place: str, view: View) -> Iterator[Violation]:
        shape = self._shapes.get(name)
        if shape is not None:
            for each in shape.violations_in(NamedNode(node + place), view):
                yield each if not place else _below(place[1:], each)
        for attribute, field_name, kind, is_array in self._steps.get(name, ()):
            value = getattr(message, attribute)
            if not is_array:
                yield from self._broken(kind, value, node, f"{place}.{field_name}", view)
                continue
            for index, element in enumerate(value):
                yield from self._broken(kind, element, node, f"{place}.{field_name}.{index}", view)

    def _strangers(self) -> Iterator[Violation]:
        for name, shape in self._shapes.items():
            own = self._space.property_of(name, "")
            known = {f"{own}{each.name}" for each in self._schema.types[name].fields}
            for path in shape.paths or ():
                if path.value.startswith(own) and path.value not in known:
                    yield Violation(
                        "",
                        f"cannot be written while the limit <{shape.iri}> is about {path.value[len(own) :]!r}, which "
                        f"is not a field of {name}: correct the shapes that rosld was given (--shapes)",
                    )

    def _reaching(self) -> set[str]:
        """Return the types that contain a type with a shape, at any depth."""
        types = self._schema.types
        found: set[str] = set()
        while more := {
            name
            for name, kind in types.items()
            if name not in found and any(each.nested in {*found, *self._shapes} for each in kind.fields)
        }:
            found |= more
        return found

    def _inner(self, name: str, wanted: Set[str]) -> tuple[tuple[str, str, str, bool], ...]:
        """Return the fields with nested limited types: attribute, name, type, whether it is an array."""
        return tuple(
            (each.attribute, each.name, each.nested, isinstance(each.type, Array))
            for each in self._schema.types[name].fields
            if each.nested is not None and each.nested in wanted
        )


def _below(place: str, violation: Violation) -> Violation:
    return replace(violation, path=f"{place}.{violation.path}" if violation.path else place)


# Bounds


@lru_cache(maxsize=1024)
def _bounds(limits: Limits, schema: MessageSchema) -> Mapping[str, Bounds]:
    space = Space("http://0/", limits.types)
    return _bounds_of(limits, schema, schema.ref.name, space)


def _bounds_of(limits: Limits, schema: MessageSchema, name: str, space: Space) -> dict[str, Bounds]:
    """Return the bounds of a type and its nested types."""
    shape = limits.by_class.get(space.class_of(name))
    own: dict[str, Bounds] = {}
    if shape is not None:
        for way, bounds in shape.within.items():
            path = _dotted_path(schema, name, way, space)
            if path is not None:
                own[path] = bounds
    inner = (
        {f"{each.name}.{path}": bounds for path, bounds in _bounds_of(limits, schema, each.nested, space).items()}
        for each in schema.types[name].fields
        if each.nested is not None
    )
    return merge_bounds(own, *inner)


def _dotted_path(schema: MessageSchema, name: str, way: Sequence[NamedNode], space: Space) -> str | None:
    """Return the dotted path of the scalar that predicates lead to; None if they lead to none."""
    kind: object = Nested(name)
    steps = []
    for predicate in way:
        if not isinstance(kind, Nested):
            return None
        fields = {space.property_of(kind.name, each.name): each for each in schema.types[kind.name].fields}
        found = fields.get(predicate.value)
        if found is None:
            return None
        steps.append(found.name)
        kind = found.type
    return ".".join(steps) if isinstance(kind, Primitive) else None
