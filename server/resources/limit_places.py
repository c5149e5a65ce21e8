"""What the limits in force are about: the types of messages and of values of resources, as far as they are known."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

from pyoxigraph import Triple

from rosld.adapters.model import Graph, MessageSchema, RosError, ServiceSchema, TypeRef
from rosld.ontology.urls import Location, Space
from rosld.ontology.vocab import rdf, ros
from rosld.server.hypermedia.affordance_service import AffordanceService
from rosld.server.hypermedia.catalogue import ParameterSource, Setter, TopicSource
from rosld.server.hypermedia.value import scalar_field
from rosld.server.resources.accepted_shape import property_writer
from rosld.server.resources.limit_checks import LimitChecks
from rosld.server.rest.state import State
from rosld.server.robot.session import Session
from rosld.shapes.limit_datatypes import limit_datatypes
from rosld.shapes.limit_paths import Place, ResourcePlace, ValuePlace


async def load_limited_types(
    session: Session, affordances: AffordanceService[State], limit_checks: LimitChecks
) -> None:
    """Get the definitions of what limits are about, as far as the robot has them."""
    await affordances.tree()
    refs = [TypeRef(name) for name in map(session.space.type_of, limit_checks.limits.by_class) if name is not None]
    refs += [
        ref
        for location in _locations(session.space, limit_checks)
        if (ref := _type(session.graph, location)) is not None
    ]
    for ref in refs:
        with suppress(RosError):
            await session.schemas.get(ref)


def datatypes_of_limits(
    session: Session, affordances: AffordanceService[State], limit_checks: LimitChecks
) -> tuple[Triple, ...]:
    """The datatypes of the fields that limits are about."""
    return limit_datatypes(limit_checks.limits, tuple(_places(session, affordances, limit_checks)), session.space.types)


def _places(
    session: Session, affordances: AffordanceService[State], limit_checks: LimitChecks
) -> Iterator[tuple[str, Place]]:
    """Each target of a limit, and what it is."""
    for iri in limit_checks.limits.by_class:
        name = session.space.type_of(iri)
        schema = None if name is None else session.schemas.find_cached(TypeRef(name))
        if isinstance(schema, MessageSchema):
            yield iri, ValuePlace.message(schema)
    for url in limit_checks.limits.by_url:
        location = session.space.location(url)
        found = None if location is None else _place(session, affordances, location)
        if found is not None:
            yield url, found


def _locations(space: Space, limit_checks: LimitChecks) -> Iterator[Location]:
    for url in limit_checks.limits.by_url:
        location = space.location(url)
        if location is not None:
            yield location


def _type(graph: Graph, location: Location) -> TypeRef | None:
    """The type of a topic or a service."""
    topic = graph.topics.get(location.name) if location.kind == "topics" else None
    service = graph.services.get(location.name) if location.kind == "services" else None
    return topic.type if topic is not None else None if service is None else service.type


def _place(session: Session, affordances: AffordanceService[State], location: Location) -> ResourcePlace | None:
    if location.kind == "parameters":
        parameter = session.graph.parameters.get(location.name)
        type = None if parameter is None or parameter.descriptor is None else parameter.descriptor.type
        return None if type is None else ResourcePlace(ros.value, ValuePlace(type))
    if location.kind == "resources":
        return ResourcePlace(rdf.value, _value_of_property(session, affordances, location.name))
    ref = _type(session.graph, location)
    schema = None if ref is None else session.schemas.find_cached(ref)
    if isinstance(schema, ServiceSchema):
        return ResourcePlace(ros.request, ValuePlace.message(schema.request))
    return ResourcePlace(ros.latest, ValuePlace.message(schema)) if isinstance(schema, MessageSchema) else None


def _value_of_property(session: Session, affordances: AffordanceService[State], name: str) -> ValuePlace | None:
    """What a property is written as: a scalar where its message is one."""
    tree = affordances.cached_tree() or affordances.last_tree
    plan = None if tree is None else tree.property(name)
    writer = None if plan is None else property_writer(session.adapter, session.settings, plan.source)
    match writer:
        case ParameterSource(name=parameter):
            found = _place(
                session, affordances, Location("parameters", tuple(parameter[1:].split("/")), is_container=False)
            )
            return None if found is None else found.value
        case Setter(schema=service):
            schema = service.request
        case TopicSource(schema=known) if known is not None:
            schema = known
        case _:
            return None
    whole, scalar = ValuePlace.message(schema), scalar_field(schema.type.fields)
    if plan is not None and plan.member.field is not None:
        return whole.field(plan.member.field)
    return whole if scalar is None else whole.field(scalar.name)
