"""SHACL shapes of the RDF that resources accept (SHACL 1.0 Core, LDP 4.2.1.6), and datatypes of limited fields.

They differ from the shapes of documents (`message.py`): more lexical forms are accepted than are ever written, elided
values are not, and limits apply. The graph is about one resource and self-contained: data that conforms to it according
to any validator fits and is within the limits.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence, Set
from functools import lru_cache
from typing import TypeAlias

from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.adapters.model import Array, FieldType, MessageSchema, MessageType, Nested, ParameterType, Primitive
from rosld.ontology.compile import TIME
from rosld.ontology.document import Document
from rosld.ontology.fields import fields_along
from rosld.ontology.lower_graph import IGNORED
from rosld.ontology.triples import RDF_SOURCE, Statement, Value, integer, labelled, statements, text
from rosld.ontology.urls import Space
from rosld.ontology.vocab import dcterms, rdf, rdfs, ros, sh, xsd
from rosld.shapes.accepted_values import AcceptedValues, OpenParameter
from rosld.shapes.limit_parts import NO_DEMAND, Demand, Place, ValuePlace, is_limited_text, limited_texts, write_limit
from rosld.shapes.limits import Limits
from rosld.shapes.message import MessageShapes
from rosld.shapes.shapes_graph import Node, ShapesGraph
from rosld.shapes.writer import ShapesWriter, list_of, within

_DATE_TIME = (
    r"^\s*[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}(\.[0-9]{1,9}0{0,21})?(Z|[+-][0-9]{2}:[0-9]{2})\s*$"
)
_FIRST, _LAST = "1901-12-13T20:45:52Z", "2038-01-19T03:14:07.999999999Z"
"""Range of 32-bit seconds."""


def accepted_message_document(
    url: str, schema: MessageSchema, space: Space, title: str, demand: Demand = NO_DEMAND
) -> Document:
    """Return the shape of RDF that contains a message to send, as the document at `url`.

    For a type without fields the RDF may be empty.
    """
    writer, class_ = ShapesWriter(url), NamedNode(space.class_of(schema.ref.name))
    _describe(writer, space, title, demand)
    shapes = AcceptedShapes(writer, schema, space, AcceptedValues(writer, demand.largest), is_target=True)
    shapes.write()
    if schema.type.fields:
        present = writer.blank(
            (sh.path, writer.blank((sh.inversePath, rdf.type))),
            (sh.minCount, integer(1)),
            (sh.message, text(f"A node of the type <{class_.value}> is missing.")),
        )
        writer.add(writer.node("body"), (rdf.type, sh.NodeShape), (sh.targetNode, class_), (sh.property, present))
    shapes.write_demand(demand)
    return Document(url, tuple(writer.triples))


Accepted: TypeAlias = Primitive | MessageSchema | ParameterType | OpenParameter
"""Kind of a value: a scalar, a message, or a parameter with or without a declaration."""


def accepted_value_document(
    url: str,
    subject: str,
    predicate: NamedNode,
    kinds: Sequence[tuple[Accepted, Demand]],
    space: Space,
    title: str,
) -> Document:
    """Return the shape of RDF in which `subject` has one value of a predicate, as the document at `url`.

    The value is of one of these `kinds` and within the limits.
    """
    writer, root = ShapesWriter(url), NamedNode(subject)
    # All kinds are sent to the same topic, service or parameter.
    values, alternatives = AcceptedValues(writer, kinds[0][1].largest), list[Value]()
    _describe(writer, space, title, Demand(is_all=all(demand.is_all for _, demand in kinds)))
    for kind, demand in kinds:
        if isinstance(kind, MessageSchema):
            shapes = AcceptedShapes(writer, kind, space, values, is_target=False)
            shapes.write()
            shapes.write_demand(demand)
            is_one = writer.blank((sh.path, rdf.type), (sh.hasValue, NamedNode(space.class_of(kind.ref.name))))
            alternatives.append(writer.blank((sh.node, shapes.node(kind.ref.name)), (sh.property, is_one)))
            continue
        alternatives.append(_scalar(writer, values, kind, demand.at("")))
    value = writer.node("value")
    writer.add(
        value,
        (rdf.type, sh.PropertyShape),
        (sh.path, predicate),
        (sh.minCount, integer(1)),
        (sh.maxCount, integer(1)),
        writer.either(alternatives),
    )
    writer.add(writer.node("body"), (rdf.type, sh.NodeShape), (sh.targetNode, root), (sh.property, value))
    return Document(url, tuple(writer.triples))


def _scalar(
    writer: ShapesWriter, values: AcceptedValues, kind: Primitive | ParameterType | OpenParameter, demand: Demand
) -> Value:
    """Return the shape of a constrained literal."""
    if isinstance(kind, OpenParameter):
        ranges = [each for _, bounds in demand.bounds for each in values.bounds(Primitive("float64"), bounds)]
        shapes: list[Value] = [values.open_parameter(kind), *(writer.blank(*each) for each in ranges)]
        return writer.blank((sh.and_, writer.list_of(shapes)))
    own, place = values.scalar(kind) if isinstance(kind, Primitive) else values.parameter(kind), ValuePlace(kind)
    if place.primitive is None:
        return own
    bounds = [each for _, bounds in demand.bounds for each in values.bounds(place.primitive, bounds, place.datatype)]
    demands = [writer.blank(*each) for each in bounds]
    demands += [write_limit(writer, values, part) for _, part in demand.value_parts]
    demands += [writer.blank((sh.datatype, xsd.string))] if is_limited_text(place.primitive, demand) else []
    return writer.blank((sh.and_, writer.list_of([own, *demands])))


def _describe(writer: ShapesWriter, space: Space, title: str, demand: Demand) -> None:
    more = None if demand.is_all else NamedNode(space.shape("limits"))
    comment = "Further limits apply that concern more than values: see the other shapes graph."
    writer.add(
        writer.node(),
        *RDF_SOURCE,
        *labelled(dcterms.title, title),
        (rdfs.comment, text(comment) if more else None),
        (rdfs.seeAlso, more),
    )


class AcceptedShapes(MessageShapes):
    """Writer of the shapes of accepted messages.

    Nodes of nested messages need not state their types. They are targets by the property that links to them, so that no
    shape contains another: validators limit the nesting of shapes. `is_target`: so is every node of the type.
    """

    def __init__(
        self, writer: ShapesWriter, schema: MessageSchema, space: Space, values: AcceptedValues, *, is_target: bool
    ) -> None:
        super().__init__(writer, schema, space)
        self._values = values
        self._is_target = is_target

    def node(self, name: str) -> NamedNode:
        return self._writer.node(name)

    def least(self, kind: MessageType) -> int | None:
        return None if kind.name == TIME else 1

    def value(self, kind: FieldType) -> Sequence[Statement]:
        match kind:
            case Nested():
                return [(sh.nodeKind, sh.BlankNodeOrIRI)]
            case Array(Nested(name)):
                return [(sh.node, list_of(self._writer, [(sh.node, self.node(name))], kind))]
            case Array():
                return [(sh.node, self._values.array(kind))]
        return [(sh.node, self._values.scalar(kind))]

    def message(self, kind: MessageType) -> Sequence[Statement]:
        writer, class_ = self._writer, NamedNode(self._space.class_of(kind.name))
        types = writer.blank((sh.path, rdf.type), (sh.in_, writer.list_of([class_, ros.Message])))
        return [
            *self._targets(kind.name, class_),
            (sh.nodeKind, sh.BlankNodeOrIRI),
            (sh.ignoredProperties, writer.list_of(sorted(IGNORED, key=str))),
            (sh.property, types),
            *(self._stamp(kind) if kind.name == TIME else ()),
        ]

    def _targets(self, name: str, class_: NamedNode) -> Iterator[Statement]:
        if self._is_target and name == self._schema.ref.name:
            yield sh.targetClass, class_
        for kind in self._schema.types.values():
            for field in kind.fields:
                if field.type == Nested(name):
                    yield sh.targetObjectsOf, NamedNode(self._space.property_of(kind.name, field.name))

    def _stamp(self, kind: MessageType) -> list[Statement]:
        """Write that a stamp has seconds and nanoseconds, or the equivalent dateTime."""
        writer = self._writer
        fields = [NamedNode(self._space.property_of(kind.name, field.name)) for field in kind.fields]
        whole = [writer.blank((sh.path, path), (sh.minCount, integer(1))) for path in fields]
        none = [writer.blank((sh.path, path), (sh.maxCount, integer(0))) for path in fields]
        moment = writer.blank(
            (sh.path, ros.dateTime),
            (sh.minCount, integer(1)),
            (sh.maxCount, integer(1)),
            (sh.datatype, xsd.dateTime),
            (sh.pattern, text(_DATE_TIME)),
            (sh.minInclusive, Literal(_FIRST, datatype=xsd.dateTime)),
            (sh.maxInclusive, Literal(_LAST, datatype=xsd.dateTime)),
        )
        plain = writer.blank(*statements(sh.property, whole))
        derived = writer.blank(*statements(sh.property, [*none, moment]))
        return [writer.either([plain, derived])]

    def write_demand(self, demand: Demand) -> None:
        """Write the constraints of limits on the message, on nested messages, and on single scalars."""
        root = self.node(self._schema.ref.name)
        for name, part in demand.type_parts:
            self._writer.add(self.node(name), (sh.node, write_limit(self._writer, self._values, part)))
        for path, part in demand.value_parts:
            shape = write_limit(self._writer, self._values, part)
            way = self._way(path) if path else None
            whole = (
                (sh.node, shape)
                if way is None
                else (sh.property, self._writer.blank((sh.path, way[0]), (sh.node, shape)))
            )
            self._writer.add(root, whole)
        self._write_texts(limited_texts(demand, self._schema, self._space))
        for path, bounds in demand.bounds:
            if (found := self._way(path)) is not None:
                for each in self._values.bounds(found[1], bounds):
                    self._writer.add(root, (sh.property, self._writer.blank((sh.path, found[0]), *each)))

    def _write_texts(self, properties: Set[NamedNode]) -> None:
        """Require limited texts to be written as text."""
        for kind in self._schema.types.values() if properties else ():
            for field in kind.fields:
                if NamedNode(self._space.property_of(kind.name, field.name)) in properties:
                    self._writer.add(within(self.node(kind.name), field.name), (sh.datatype, xsd.string))

    def _way(self, path: str) -> tuple[Value, Primitive] | None:
        """Return the property path to a scalar, and its type; None if the message has none there."""
        fields = fields_along(self._schema, path)
        kind = fields[-1][1].type if fields else None
        if not isinstance(kind, Primitive):
            return None
        writer, steps = self._writer, list[Value]()
        for name, field in fields:
            steps.append(NamedNode(self._space.property_of(name, field.name)))
            if isinstance(field.type, Array):
                steps += [writer.blank((sh.zeroOrMorePath, rdf.rest)), rdf.first]
        return (steps[0] if len(steps) == 1 else writer.list_of(steps)), kind


@lru_cache(maxsize=8)
def limit_datatypes(limits: Limits, places: tuple[tuple[str, Place], ...], types: str) -> tuple[Triple, ...]:
    """Return `sh:datatype` for each property shape of the limits that leads to one scalar and does not state it.

    `places` are the targets by IRI. This constrains nothing: the server writes fields with these datatypes, but bodies
    may have others (`URL?shape`).
    """
    graph, known, space = ShapesGraph(limits.graph), dict(places), Space("http://0/", types)
    found: dict[Node, set[NamedNode]] = {}
    for node, _, target in graph.targets():
        place = known.get(target.value) if isinstance(target, NamedNode) else None
        if place is not None:
            for shape, datatype in _datatypes(graph, node, place, space):
                found.setdefault(shape, set()).add(datatype)
    return tuple(Triple(shape, sh.datatype, each) for shape, one in found.items() if len(one) == 1 for each in one)


def _datatypes(graph: ShapesGraph, node: Node, place: Place, space: Space) -> Iterator[tuple[Node, NamedNode]]:
    own = graph.statements(node)
    for path in own.get(sh.path, ()):
        found = place.follow(path, space) if isinstance(path, NamedNode) else None
        if found is None:
            return
        place = found
        if found.datatype is not None and sh.datatype not in own:
            yield node, found.datatype
    inner = [*own.get(sh.property, ()), *own.get(sh.node, ()), *own.get(sh.not_, ())]
    inner += [each for key in (sh.and_, sh.or_, sh.xone) for head in own.get(key, ()) for each in graph.members(head)]
    for each in inner:
        if isinstance(each, NamedNode | BlankNode):
            yield from _datatypes(graph, each, place, space)
