"""Observations and actuations: what messages mean in the terms of SOSA (2023 edition).

The table `sensors.ttl` says which fields of a message type are observed or commanded. From it come the sensor or the
actuator of a topic, which need no message, and the observations or actuations of a message, which are written by a
function that is compiled per schema and notation, like the message itself.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from enum import Enum
from functools import cache, lru_cache, partial
from struct import Struct as Packer
from types import MappingProxyType
from typing import NamedTuple, cast

from msgspec import Struct
from pyoxigraph import NamedNode, Triple

from rosld.adapters.model import Array, Field, Graph, Message, MessageSchema, Primitive, Topic
from rosld.ontology import kinds
from rosld.ontology.geometry import frame_iri
from rosld.ontology.lift import TYPES
from rosld.ontology.literals import DATATYPES, date_time, json_numbers, scalar_texts, unpack_float32
from rosld.ontology.modules import module_triples
from rosld.ontology.names import TypeName, type_names
from rosld.ontology.neutral_message import COMMANDS, HEADER
from rosld.ontology.node_shape import NodeShape, Property, many, one
from rosld.ontology.syntax_codegen import const
from rosld.ontology.triples import text
from rosld.ontology.units import has_numbers, quantity_of
from rosld.ontology.urls import Space
from rosld.ontology.vocab import NAMESPACES, PREFIXES, dqv, owl_time, qudt, rdf, rdfs, ros, sosa, xsd

SENSOR, ACTUATOR = "#sensor", "#actuator"
_STANDARD = frozenset(
    f"{name}_msgs"
    for name in ("std", "geometry", "sensor", "nav", "control", "diagnostic", "tf2", "stereo", "shape", "trajectory")
)
"""Packages whose message types are in the table if they observe or command anything."""


_DIMENSIONLESS = PREFIXES["quantitykind"] + "Dimensionless"


class Role(Enum):
    """Role of the messages of a topic."""

    SENSOR = SENSOR
    ACTUATOR = ACTUATOR


class Observed(NamedTuple):
    """An observed or commanded field, and the path from the message to its covariance, () for none."""

    field: str
    covariance: tuple[str, ...] = ()


class _Table(NamedTuple):
    observed: Mapping[str, Sequence[Observed]]
    commanded: Mapping[str, Sequence[Observed]]
    exteroceptive: frozenset[str]


@cache
def _table() -> _Table:
    """Return the table of `sensors.ttl`, by name of the message type."""
    triples = [triple for triple in module_triples("sensors") if isinstance(triple.object, NamedNode)]
    covariances = {
        _local(each.subject): _local(each.object) for each in triples if each.predicate == ros.covarianceField
    }

    def fields(predicate: NamedNode) -> dict[str, list[Observed]]:
        found: dict[str, list[Observed]] = {}
        for each in triples:
            if each.predicate == predicate:
                name, _, field = _local(each.object).partition("#")
                owner, _, covariance = covariances.get(f"{name}#{field}", "").partition("#")
                path = () if not covariance else (covariance,) if owner == name else (field, covariance)
                found.setdefault(name, []).append(Observed(field, path))
        return found

    outside = (each.subject for each in module_triples("sensors") if each.predicate == ros.isExteroceptive)
    return _Table(fields(ros.observes), fields(ros.commands), frozenset(map(_local, outside)))


def _local(term: object) -> str:
    return cast(NamedNode, term).value.removeprefix(TYPES)


def observed_fields(name: str, role: Role, schema: MessageSchema | None) -> Sequence[Observed]:
    """Return the observed or commanded fields of a message type; with its schema, those of this version of it.

    For types of packages that the table does not cover, the observed fields are the numbers whose units are known.
    """
    table = _table()
    known = (table.observed if role is Role.SENSOR else table.commanded).get(name)
    if schema is None or known is not None:
        present = None if schema is None else {field.name for field in schema.type.fields}
        return [each for each in known or () if present is None or each.field in present]
    if role is Role.ACTUATOR or name.partition("/")[0] in _STANDARD:
        return ()
    numbers = (field for field in schema.type.fields if isinstance(field.type, Primitive) and has_numbers(field.type))
    return [Observed(field.name) for field in numbers if quantity_of(name, field.name) is not None]


def role_of(topic: Topic, graph: Graph, schema: MessageSchema | None) -> Role | None:
    """Return what the messages of a topic are: observations of the robot, commands to it, or neither.

    A node of the robot (not rosld) must publish the observations, or subscribe to the commands. A topic of a type that
    is used for both (std_msgs) is a command if nobody else publishes it.
    """
    if topic.type is None:
        return None
    name = topic.type.name
    publishers = any(each.node != graph.own_node for each in topic.publishers)
    subscribers = any(each.node != graph.own_node for each in topic.subscribers)
    if (publishers or not subscribers) and observed_fields(name, Role.SENSOR, schema):  # recordings name no publishers
        return Role.SENSOR
    is_command = subscribers and (not publishers or name in COMMANDS)
    return Role.ACTUATOR if is_command and observed_fields(name, Role.ACTUATOR, schema) else None


# --- the sensor or the actuator of a topic

_LABEL: Property[str] = one(rdfs.label, kinds.TEXT)
_HOST: Property[str] = one(sosa.isHostedBy, kinds.IRI.where('sh:pattern "#robot$"'), lambda base: f"{base}#robot")
_FRAME: Property[str] = many(ros.frame, kinds.IRI.where('sh:pattern "/frames#"'))
_SENSOR = NodeShape[str](
    "TopicSensor", "the sensor of a topic", sosa.Sensor, target="sh:targetObjectsOf ros:sensor"
).with_properties(_LABEL, _HOST, many(sosa.observes, kinds.IRI, minimum=1), _FRAME)
_ACTUATOR = NodeShape[str](
    "TopicActuator", "the actuator of a topic", sosa.Actuator, target="sh:targetObjectsOf ros:actuator"
).with_properties(_LABEL, _HOST, _FRAME)


def device_triples(topic: Topic, role: Role, schema: MessageSchema | None, space: Space) -> list[Triple]:
    """Return the sensor or actuator of a topic, with the link to it."""
    url = space.topic(topic.name)
    device = NamedNode(url + role.value)
    label = (rdfs.label, text(topic.name[1:].replace("/", " ")))
    if role is Role.ACTUATOR:
        return [Triple(NamedNode(url), ros.actuator, device), *_ACTUATOR.triples(device, space.base, space, label)]
    assert topic.type is not None
    name = topic.type.name
    fields = observed_fields(name, role, schema)
    quantities = [quantity_of(name, each.field) for each in fields]
    kinds_of = (each.kind for each in quantities if each is not None and each.kind is not None)
    observed = [each for each in kinds_of if each != _DIMENSIONLESS]
    observed = observed or [space.property_of(name, each.field) for each in fields]
    observes = [(sosa.observes, NamedNode(each)) for each in dict.fromkeys(observed)]
    return [Triple(NamedNode(url), ros.sensor, device), *_SENSOR.triples(device, space.base, space, label, *observes)]


# --- the observations or actuations of a message


class Observer(Struct, frozen=True):
    """Writer of the observations (or actuations) of the messages of one topic.

    `device` is the URL of the sensor or actuator, `base` that of the server.
    """

    schema: MessageSchema
    role: Role
    types: str
    device: str
    base: str

    @property
    def prefixes(self) -> Mapping[str, str]:
        """The prefixes in Turtle, in addition to those of the message."""
        return _compiled(self.schema, self.role, self.types, "turtle").prefixes

    @property
    def context(self) -> Mapping[str, object]:
        """The terms in JSON-LD, in addition to those of the message."""
        return _compiled(self.schema, self.role, self.types, "jsonld").context

    def text(
        self, notation: str, message: Message, document: str, node: str, received_ns: int | None, *,
        simulated_time: bool, end: str = " .\n",
    ) -> str:  # fmt: skip
        """Return the statements about a message with a node in a document; in JSON-LD, node objects with commas.

        `node` is a fragment. Observations of NaN (BatteryState: not measured) are left out.
        """
        write = _compiled(self.schema, self.role, self.types, notation).write
        device, base = self.device, self.base
        if notation == "ntriples":
            node = document + node
        else:  # relative to the document, which is shorter
            device = device.removeprefix(document)
            base = base[base.index("/", base.index("//") + 2) :]
        feature = f"{base}#{'surroundings' if self.schema.ref.name in _table().exteroceptive else 'robot'}"
        received = "" if received_ns is None else date_time(0, received_ns)
        return write(message, node, device, feature, received, f"{base}frames", simulated_time, end)


_OBSERVED = {
    Role.SENSOR: (sosa.Observation, sosa.observedProperty, sosa.madeBySensor),
    Role.ACTUATOR: (sosa.Actuation, sosa.actsOnProperty, sosa.madeByActuator),
}
_LINKS = (
    sosa.observedProperty, sosa.actsOnProperty, sosa.madeBySensor, sosa.madeByActuator, sosa.hasFeatureOfInterest,
    sosa.hasResult, sosa.resultQuality, sosa.phenomenonTime, qudt.hasUnit, ros.frame,
)  # fmt: skip
_VALUES = (sosa.resultTime, sosa.hasSimpleResult, qudt.numericValue, owl_time.inXSDDateTimeStamp, dqv.value)
_CLASSES = (sosa.Observation, sosa.Actuation, qudt.QuantityValue, owl_time.Instant, dqv.QualityMeasurement)
PREDICATES = frozenset(each.value for each in (*_LINKS, *_VALUES, rdf.type))
CLASSES = frozenset(each.value for each in _CLASSES)
"""Terms of observations and actuations, by which queries need them."""
_PREFIXES = MappingProxyType(
    {name: PREFIXES[name] for name in ("sosa", "qudt", "unit", "dqv", "ros", "rdf", "xsd", "owl-time")}
)


def _curie(iri: str) -> str:
    """Return an IRI as a prefixed name, or in full."""
    cut = max(iri.rfind("#"), iri.rfind("/")) + 1
    prefix = NAMESPACES.get(iri[:cut])
    return f"{prefix}:{iri[cut:]}" if prefix in _PREFIXES else iri


_TERMS: Mapping[str, object] = {
    **{_curie(each.value): {"@id": each.value, "@type": "@id"} for each in _LINKS},
    _curie(sosa.resultTime.value): {"@id": sosa.resultTime.value, "@type": xsd.dateTime.value},
}


class _Compiled(NamedTuple):
    """A compiled function with the prefixes and JSON-LD terms that its text uses."""

    write: Callable[[Message, str, str, str, str, str, bool, str], str]
    prefixes: Mapping[str, str]
    context: Mapping[str, object]


class _Form:
    """The writing of a node with its type, its parts and their values in a notation, as fragments of f-strings."""

    def __init__(self, head: str, part: str, end: str, link: str, literal: str, *, is_short: bool, quotes: str) -> None:
        """In the texts `SUBJECT`, `TERM`, `VALUE`, `TYPE` stand for what is replaced, `END` for the end of a line."""
        self._head, self._part, self._end, self._link, self._literal = map(const, (head, part, end, link, literal))
        self._is_short = is_short
        self._quotes = quotes

    def node(self, subject: str, kind: NamedNode, parts: str) -> str:
        return self._fill(self._head, subject, kind.value) + parts + self._end

    def part(self, subject: str, predicate: NamedNode, value: str) -> str:
        return self._fill(self._part, subject, predicate.value).replace("VALUE", value)

    def link(self, iri: str) -> str:
        """Return a link to a node whose IRI is a fragment."""
        return self._link.replace("VALUE", iri)

    def term(self, iri: str) -> str:
        """Return a constant IRI."""
        name = _curie(iri) if self._is_short else iri
        return const(self._quotes[0] + name + self._quotes[-1] if self._quotes[0] == '"' or name == iri else name)

    def field(self, name: TypeName, field: str) -> str:
        """Return the IRI of a field, with the prefix of its message in Turtle."""
        return const(f"{name.prefix}:{field}") if self is _FORMS["turtle"] else self.term(name.property(field))

    def literal(self, datatype: NamedNode, value: str) -> str:
        return self._literal.replace("TYPE", self.term(datatype.value)).replace("VALUE", value)

    def _fill(self, text: str, subject: str, iri: str) -> str:
        return text.replace("TERM", self.term(iri)).replace("SUBJECT", subject).replace("END", "{e}")


_FORMS = {
    "ntriples": _Form(
        f"<SUBJECT> <{rdf.type.value}> TERMEND", "<SUBJECT> TERM VALUEEND", "", "<VALUE>", '"VALUE"^^TYPE',
        is_short=False, quotes="<>",
    ),
    "turtle": _Form(
        "<SUBJECT> a TERM", " ;\n    TERM VALUE", " .\n", "<VALUE>", '"VALUE"^^TYPE', is_short=True, quotes="<>"
    ),
    "jsonld": _Form(
        '{"@id":"SUBJECT","@type":TERM', ",TERM:VALUE", "},", '"VALUE"', '{"@value":"VALUE","@type":TYPE}',
        is_short=True, quotes='""',
    ),
}  # fmt: skip


@lru_cache(maxsize=512)
def _compiled(schema: MessageSchema, role: Role, types: str, notation: str) -> _Compiled:
    """Return the function that writes the observations of messages of a schema."""
    source = _Source(schema, role, types, _FORMS[notation])
    text = "def observe(m, n, s, f, r, p, simulated, e):\n " + "\n ".join(source.lines()) + "\n"
    exec(compile(text, f"<observer of {schema.ref.name}>", "exec"), source.namespace)
    prefixes = {name: iri for name, iri in _PREFIXES.items() if re.search(rf"[^\w-]{name}:", text)}
    context = {**prefixes, **{name: term for name, term in _TERMS.items() if f'"{name}"' in text}}
    return _Compiled(source.namespace["observe"], prefixes, context)  # type: ignore[arg-type] # of the right type


class _Source:
    """The source of one function, and the namespace in which it runs.

    Its parameters: message, node, device, feature of interest, time of receipt, prefix of frames, whether time is
    simulated, end of a line.
    """

    def __init__(self, schema: MessageSchema, role: Role, types: str, form: _Form) -> None:
        self.namespace: dict[str, object] = {
            "scalars": scalar_texts,
            "singles": unpack_float32,
            "pack": Packer("<f").pack,
            "numbers": partial(json_numbers, quote='\\"'),
            "date_time": date_time,
            "frame_iri": frame_iri,
        }
        self._schema = schema
        self._role = role
        self._form = form
        self._name = type_names(schema.types, types)[schema.ref.name]
        self._fields = {field.name: field for field in schema.type.fields}

    def lines(self) -> Iterator[str]:
        form = self._form
        yield "o, t = [], ''"
        header = self._fields.get("header")
        if header is not None and header.nested == HEADER:
            stamp = "{n}~time"
            moment = form.part(stamp, owl_time.inXSDDateTimeStamp, form.literal(xsd.dateTimeStamp, "{t}"))
            frame = form.part("{s}", ros.frame, form.link("{frame_iri(p, d)}"))
            device = sosa.Sensor if self._role is Role.SENSOR else sosa.Actuator
            yield "h = m.header.stamp"
            yield "t = date_time(h.sec, h.nanosec) if (h.sec or h.nanosec) and not simulated else ''"
            yield f"if t: o.append(f'{form.node(stamp, owl_time.Instant, moment)}')"
            yield "d = m.header.frame_id.lstrip('/')"
            yield f"if m.header.frame_id: o.append(f'{form.node('{s}', device, frame)}')"
        for row in observed_fields(self._schema.ref.name, self._role, self._schema):
            yield from self._row(row)
        yield "return ''.join(o)"

    def _row(self, row: Observed) -> Iterator[str]:
        """Yield the lines of one observation: its conditions, its optional parts, and the append."""
        form, field, node = self._form, self._fields[row.field], f"{{n}}~{row.field}"
        kind, predicate, by = _OBSERVED[self._role]
        value, conditions, after, simple = f"m.{field.attribute}", ["True"], "", ""
        result = "{n}" if isinstance(field.type, Array) else f"{{n}}.{row.field}"
        if isinstance(field.type, Primitive):
            yield f"v, = scalars({f'singles(pack({value}))' if field.type.name == 'float32' else f'({value},)'})"
            literal = form.literal(xsd.terms[DATATYPES[field.type.name]], "{v}")
            simple = form.part(node, sosa.hasSimpleResult, literal)
            quantity = quantity_of(self._schema.ref.name, row.field)
            if quantity is not None and quantity.unit is not None:
                numeric = form.part(result, qudt.numericValue, literal)
                unit = form.part(result, qudt.hasUnit, form.term(quantity.unit))
                after = form.node(result, qudt.QuantityValue, numeric + unit)
            else:
                result = ""
            conditions = [f"{value} == {value}"]
        parts = [
            form.part(node, predicate, form.field(self._name, row.field)),
            simple,
            form.part(node, sosa.hasResult, form.link(result)) if result else "",
            form.part(node, by, form.link("{s}")),
            form.part(node, sosa.hasFeatureOfInterest, form.link("{f}")),
        ]
        yield f"a = f'{form.part(node, sosa.phenomenonTime, form.link('{n}~time'))}' if t else ''"
        received = form.literal(xsd.dateTime, "{r}")
        yield f"b = f'{form.part(node, sosa.resultTime, received)}' if r else ''"
        yield "q = k = ''"
        if path := self._path(row.covariance):
            yield from self._covariance(path, node)
            conditions += ["c[0] != -1"] if isinstance(path[-1].type, Array) else []
        text = form.node(node, kind, "".join(parts) + "{a}{b}{q}") + after + "{k}"
        yield f"if {' and '.join(conditions)}: o.append(f'{text}')"

    def _path(self, names: Iterable[str]) -> list[Field]:
        """Return the fields along a path from the message; none if this version of the type lacks one."""
        found, kind = [], self._schema.type
        for name in names:
            field = next((each for each in kind.fields if each.name == name), None)
            if field is None:
                return []
            found.append(field)
            kind = self._schema.types[field.nested] if field.nested else kind
        return found

    def _covariance(self, path: Sequence[Field], node: str) -> Iterator[str]:
        """Yield the lines of the quality of a result, which is left out if the covariance is zero: unknown."""
        form, quality, is_array = self._form, f"{node}.covariance", isinstance(path[-1].type, Array)
        literal = form.literal(rdf.JSON if is_array else xsd.double, "{w}")
        yield f"c = {'.'.join(['m', *(field.attribute for field in path)])}"
        yield f"g = {'c.any()' if is_array else 'c'}"
        yield f"w = {'numbers(c)' if is_array else 'scalars((c,))[0]'} if g else ''"
        yield f"q = f'{form.part(node, sosa.resultQuality, form.link(quality))}' if g else ''"
        measurement = form.node(quality, dqv.QualityMeasurement, form.part(quality, dqv.value, literal))
        yield f"k = f'{measurement}' if g else ''"
