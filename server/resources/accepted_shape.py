"""`URL?shape`: the shape of the RDF that a resource accepts, with its limits (LDP 4.2.1.6)."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterator
from contextlib import suppress

from msgspec.structs import replace
from pyoxigraph import NamedNode, Triple

from rosld.adapters.model import Descriptor, Graph, Kind, MessageSchema, Primitive, RosError, ServiceSchema, TypeRef
from rosld.ontology.body import RdfBody
from rosld.ontology.document import Document
from rosld.ontology.lexical import BINARIES
from rosld.ontology.urls import Location, Space
from rosld.ontology.vocab import rdf, ros
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.affordance_service import AffordanceService
from rosld.server.hypermedia.catalogue import ParameterSource, Property, Setter, TopicSource, Writer
from rosld.server.hypermedia.property_writer import current_writer
from rosld.server.hypermedia.resource_tree import PropertyPlan
from rosld.server.hypermedia.value import layouts, scalar_field, select_fields
from rosld.server.resources.base import SessionResource
from rosld.server.resources.limit_checks import LimitChecks, require_no_octets
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import PathItem
from rosld.server.rest.resource import ABSENT, Resource
from rosld.server.rest.state import State
from rosld.server.robot.session import Session
from rosld.shapes.accepted import Accepted, accepted_message_document, accepted_value_document, limit_datatypes
from rosld.shapes.accepted_values import PARAMETERS, OpenParameter
from rosld.shapes.limit_parts import Demand, Place, ResourcePlace, ValuePlace, is_limited_text, limited_texts
from rosld.shapes.message import SHACL_SHACL

_LINK = "shape"
"""Query parameter that requests the shape."""


def shape_query(url: str) -> str:
    """Return the URL of the shape of the content that may be written to a URL."""
    return f"{url}?{_LINK}"


class AcceptedShape(Resource):
    """The shape of the content that may be written to a resource."""

    kind = "Shape"
    shape = SHACL_SHACL
    item = PathItem("The shape of what may be written", has_shape=True)
    is_cacheable = False

    def __init__(self, of: Resource, describe: Callable[[str], Awaitable[Document | None]]) -> None:
        super().__init__(of.space, shape_query(of.url))
        self._of = of
        self._describe = describe

    async def state(self) -> State:
        if await self._of.current_methods() == ABSENT:
            await self._of.state()  # raises the error of the resource, if any
        document = await self._describe(self.url)
        if document is None:
            raise Problem(404, f"No shape describes what can be written to {self._of.url}.")
        return State(lambda: document)


async def message_shape(
    limit_checks: LimitChecks, kind: Kind, name: str, schema: MessageSchema, shape: str
) -> Document:
    """Return the shape of messages to a topic, a service or an action, as the shapes graph at the URL `shape`."""
    space = limit_checks.session.space
    demand = await limit_checks.message_demand(kind, name, schema)
    return accepted_message_document(shape, schema, space, f"Accepted messages of {_path(shape, space)}", demand)


def _path(shape: str, space: Space) -> str:
    """Return the path of the resource of a shape; its implementation (a service, a topic) may be hidden."""
    return "/" + shape.partition("?")[0].removeprefix(space.base)


def has_parameter_shape(graph: Graph, name: str) -> bool:
    """Whether the parameter exists and is not a tree."""
    return name in graph.parameters


async def parameter_shape(limit_checks: LimitChecks, name: str, shape: str) -> Document | None:
    """Return the shape of values of a parameter, or None if it does not exist."""
    space = limit_checks.session.space
    url, kinds = space.parameter(name), await _of_parameter(limit_checks, name)
    title = f"Accepted values of {_path(shape, space)}"
    return accepted_value_document(shape, url, ros.value, kinds, space, title) if kinds else None


async def property_shape(limit_checks: LimitChecks, plan: PropertyPlan, url: str, shape: str) -> Document | None:
    """Return the shape of values of a property, or None if it has no writer or no known type."""
    space, writer = limit_checks.session.space, property_writer(limit_checks.session, plan.source)
    kinds = [] if writer is None else await _of_writer(limit_checks, plan, writer)
    title = f"Accepted values of {_path(shape, space)}"
    return accepted_value_document(shape, url, rdf.value, kinds, space, title) if kinds else None


def property_writer(session: Session, own: Property) -> Writer | None:
    """Return the writer of a property, available now or not."""
    return current_writer(session.adapter, session.settings, own) or next(iter(own.writers), None)


def has_property_shape(session: Session, plan: PropertyPlan) -> bool:
    """Whether `property_shape` has a shape of a property."""
    match property_writer(session, plan.source):
        case ParameterSource(name=name):
            return plan.member.field is None and has_parameter_shape(session.graph, name)
        case TopicSource(schema=schema):
            return schema is not None
        case Setter():
            return True
        case None:
            return False


async def require_property_text(
    limit_checks: LimitChecks, plan: PropertyPlan, body: RdfBody, subject: NamedNode, predicate: NamedNode
) -> None:
    """Raise LoweringError if a body writes a limited text of a property as octets."""
    octets = [each for each in body.literals() if each.datatype in BINARIES] if limit_checks.limits else []
    session = limit_checks.session
    writer = property_writer(session, plan.source) if octets else None
    for kind, demand in () if writer is None else await _of_writer(limit_checks, plan, writer):
        if isinstance(kind, MessageSchema):
            require_no_octets(body, limited_texts(demand, kind, session.space))
        elif isinstance(kind, Primitive) and is_limited_text(kind, demand.at("")):
            require_no_octets(body, {predicate} & body.properties(subject).keys())


async def _of_parameter(limit_checks: LimitChecks, name: str) -> list[tuple[Accepted, Demand]]:
    adapter = limit_checks.session.adapter
    parameter = adapter.graph.parameters.get(name)
    if parameter is None:
        return []
    descriptor = parameter.descriptor or Descriptor()
    is_scalar = descriptor.type in PARAMETERS
    demand = await limit_checks.parameter_demand(name, descriptor if is_scalar else Descriptor())
    if descriptor.type is None:
        in_xml = adapter.capabilities.parameter_server
        return [(OpenParameter(32 if in_xml else 64, in_xml), demand.of_ranges())]
    is_array = Demand(is_all=demand == Demand(largest=demand.largest), largest=demand.largest)
    return [(descriptor.type, demand if is_scalar else is_array)]


async def _of_writer(limit_checks: LimitChecks, plan: PropertyPlan, writer: Writer) -> list[tuple[Accepted, Demand]]:
    match writer:
        case ParameterSource():
            if plan.member.field is not None:
                return []
            return await _of_parameter(limit_checks, writer.name)
        case Setter(schema=service):
            schema, kind = service.request, Kind.SERVICE
        case TopicSource(schema=known) if known is not None:
            schema, kind = known, Kind.TOPIC
        case _:
            return []
    demand = await limit_checks.message_demand(kind, writer.name, schema)
    if plan.member.field is not None:
        return list(_of_field(limit_checks.affordances, plan, demand))
    return list(_of_message(plan.source, schema, demand))


def _of_message(own: Property, schema: MessageSchema, demand: Demand) -> Iterator[tuple[Accepted, Demand]]:
    """Yield the scalar that a message is, and the messages that say all of its fields."""
    scalar = scalar_field(schema.type.fields)
    if scalar is not None and isinstance(scalar.type, Primitive):
        yield scalar.type, _of_one_field(demand, schema, scalar.name)
    fields = [(field.name, field.type) for field in schema.type.fields]
    parts = {part.ref.name: part for each in layouts(own) if (part := select_fields(each.schema, each.fields))}
    for part in parts.values():
        if [(field.name, field.type) for field in part.type.fields] == fields:
            yield part, demand if part.ref.name == schema.ref.name else demand.of_bounds()


def _of_field(
    affordances: AffordanceService[State], plan: PropertyPlan, demand: Demand
) -> Iterator[tuple[Accepted, Demand]]:
    """Yield the one field of a message that is written where a mapping picks it."""
    path = plan.member.field or ""
    shape = affordances.member_affordance(plan.member, write=True).shape
    if isinstance(kind := getattr(shape, "kind", None), Primitive):
        yield kind, demand.at(path)


def _of_one_field(demand: Demand, schema: MessageSchema, name: str) -> Demand:
    """Return the demand on the only field of a message: every demand on the message is about it."""
    parts = [(name, part.of_value()) for type, part in demand.type_parts if type == schema.ref.name]
    return replace(demand, value_parts=(*demand.value_parts, *parts), type_parts=()).at(name)


WRITES = frozenset({"PUT", "POST", "PATCH", "DELETE"})


class CommandResource(SessionResource):
    """Base class of resources whose writes command the robot; none is offered while the robot is stopped."""

    links_offer = True

    @property
    def limit_checks(self) -> LimitChecks:
        """Checks of writes against the limits in force."""
        return self.services.limit_checks

    @property
    def withheld(self) -> frozenset[str]:
        return WRITES if self.session.is_stopped else frozenset()

    async def accepted(self, url: str) -> Document | None:
        """Return the shape of the RDF that the resource accepts, as the shapes graph at `url`, or None."""
        return None

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the shape of the accepted content if `?shape` requests it."""
        query: bytes = exchange.request.scope["query_string"]
        if b"shape" in query and exchange.method in ("GET", "HEAD") and "shape" in exchange.query:
            return AcceptedShape(self, self.accepted)
        return self


async def load_limited_types(limit_checks: LimitChecks) -> None:
    """Load the available definitions of the types that limits concern."""
    session = limit_checks.session
    await limit_checks.affordances.tree()
    refs = [TypeRef(name) for name in map(session.space.type_of, limit_checks.limits.by_class) if name is not None]
    refs += [ref for location in _locations(limit_checks) if (ref := _type(session.graph, location)) is not None]
    for ref in refs:
        with suppress(RosError):
            await session.schemas.get(ref)


def datatypes_of_limits(limit_checks: LimitChecks) -> tuple[Triple, ...]:
    """Return the datatypes of limited fields."""
    return limit_datatypes(limit_checks.limits, tuple(_places(limit_checks)), limit_checks.session.space.types)


def _places(limit_checks: LimitChecks) -> Iterator[tuple[str, Place]]:
    """Yield each target of a limit with its place."""
    session = limit_checks.session
    for iri in limit_checks.limits.by_class:
        name = session.space.type_of(iri)
        schema = None if name is None else session.schemas.find_cached(TypeRef(name))
        if isinstance(schema, MessageSchema):
            yield iri, ValuePlace.message(schema)
    for url in limit_checks.limits.by_url:
        location = session.space.location(url)
        found = None if location is None else _place(limit_checks, location)
        if found is not None:
            yield url, found


def _locations(limit_checks: LimitChecks) -> Iterator[Location]:
    for url in limit_checks.limits.by_url:
        location = limit_checks.session.space.location(url)
        if location is not None:
            yield location


def _type(graph: Graph, location: Location) -> TypeRef | None:
    """Return the type of a topic or a service."""
    topic = graph.topics.get(location.name) if location.kind == "topics" else None
    service = graph.services.get(location.name) if location.kind == "services" else None
    return topic.type if topic is not None else None if service is None else service.type


def _place(limit_checks: LimitChecks, location: Location) -> ResourcePlace | None:
    session = limit_checks.session
    if location.kind == "parameters":
        parameter = session.graph.parameters.get(location.name)
        type = None if parameter is None or parameter.descriptor is None else parameter.descriptor.type
        return None if type is None else ResourcePlace(ros.value, ValuePlace(type))
    if location.kind == "resources":
        return ResourcePlace(rdf.value, _value_of_property(limit_checks, location.name))
    ref = _type(session.graph, location)
    schema = None if ref is None else session.schemas.find_cached(ref)
    if isinstance(schema, ServiceSchema):
        return ResourcePlace(ros.request, ValuePlace.message(schema.request))
    return ResourcePlace(ros.latest, ValuePlace.message(schema)) if isinstance(schema, MessageSchema) else None


def _value_of_property(limit_checks: LimitChecks, name: str) -> ValuePlace | None:
    """Return the written form of a property: a scalar if its message has one field."""
    affordances = limit_checks.affordances
    tree = affordances.cached_tree() or affordances.last_tree
    plan = None if tree is None else tree.property(name)
    writer = None if plan is None else property_writer(limit_checks.session, plan.source)
    match writer:
        case ParameterSource(name=parameter):
            found = _place(limit_checks, Location("parameters", tuple(parameter[1:].split("/")), is_container=False))
            return None if found is None else found.value
        case Setter(schema=service):
            schema = service.request
        case TopicSource(schema=known) if known is not None:
            schema = known
        case _:
            return None
    scalar, field = scalar_field(schema.type.fields), plan.member.field if plan is not None else None
    return ValuePlace.of_field(schema, field if field is not None or scalar is None else scalar.name)
