"""Property writer: plans a write with the first available writer of the property, then carries it out."""

from __future__ import annotations

from enum import Enum
from typing import cast

from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import Literal

from rosld.adapters.model import (
    Field,
    Kind,
    Message,
    MessageSchema,
    Operation,
    ParameterValue,
    Primitive,
    Ref,
    Refused,
    Sent,
)
from rosld.ontology.coercion import Misfit
from rosld.ontology.json_leaves import json_leaf
from rosld.ontology.lift import LiftSettings
from rosld.ontology.lower import lowerer
from rosld.ontology.lower_graph import term_leaf
from rosld.ontology.parameters import lower_json, lower_term
from rosld.ontology.violations import LoweringError, Violation, brief_value
from rosld.server.http.problem import READ_ONLY, Problem
from rosld.server.hypermedia.catalogue import (
    ParameterSource,
    Property,
    Setter,
    TopicSource,
    Writer,
    source_url,
)
from rosld.server.hypermedia.value import MessageValue, StoredValue, Value, refusal_text, scalar_field, select_fields
from rosld.server.robot.audited_adapter import AuditedAdapter, errors_about, has_other_values
from rosld.server.robot.calls import UnreadableResponse
from rosld.server.robot.publication import prepare, publish
from rosld.server.robot.session import Session
from rosld.server.robot.write_policy import denied_reason, parameter_denied_reason
from rosld.server.runtime.tasks import loop_time
from rosld.server.settings import Settings
from rosld.shapes.parameter import require_form
from rosld.shapes.value import MessageShape, ScalarShape, ValueShape


class PlannedWrite(Struct, frozen=True, eq=False):
    """A write of the property `property` that has passed all checks.

    `value` is the lowered request, message or parameter value; `data` are the bytes of a request or message.
    """

    property: str
    writer: Writer
    value: Value
    data: bytes = b""


class WriteOutcome(Enum):
    """The outcome of a write."""

    DONE = "done"
    UNHEARD = "unheard"
    """The message was published without subscribers."""
    GOES_ON = "goes on"
    """The message was published and sets the robot in motion until it is stopped."""
    OTHERWISE = "otherwise"
    """The parameter was set, but its node changed the value."""


# Writers


def current_writer(adapter: AuditedAdapter, settings: Settings, property: Property) -> Writer | None:
    """Return the first available writer of the property, or None."""
    return next((one for one in property.writers if _refusal(adapter, settings, one) is None), None)


def not_writable_reason(adapter: AuditedAdapter, settings: Settings, property: Property) -> str:
    """Return sentences about why nothing can write the property now."""
    if settings.read_only:
        return READ_ONLY
    reasons = [reason for one in property.writers if (reason := _refusal(adapter, settings, one)) is not None]
    return " ".join(reasons) or f"{property.name} has no writable setter, parameter or topic."


def not_writable_about(session: Session, property: Property) -> tuple[str, ...]:
    """Return the URLs that `not_writable_reason` may name: the property's writers and the publishers on its topic."""
    space, topics = session.space, map(session.graph.topics.get, (one.name for one in property.writers))
    nodes = [space.node(each.node) for topic in topics if topic is not None for each in topic.publishers]
    return (*(source_url(one, space) for one in property.writers), *nodes)


def _refusal(adapter: AuditedAdapter, settings: Settings, writer: Writer) -> str | None:
    """Return a sentence about why a writer must not be used now; None if it may."""
    if settings.read_only:
        return READ_ONLY
    match writer:
        case Setter():
            return _setter_refusal(adapter, writer.name)
        case ParameterSource():
            return _parameter_refusal(adapter, writer.name)
        case TopicSource():
            return _topic_refusal(adapter, settings.allow_publish, writer)


def _setter_refusal(adapter: AuditedAdapter, name: str) -> str | None:
    if Operation.CALL in adapter.allows(Ref(Kind.SERVICE, name)):
        return None
    service = adapter.graph.services.get(name)
    if service is None:
        return f"The service {name} no longer exists."
    return f"The service {name} cannot be called" + (f": {service.uncallable}." if service.uncallable else ".")


def _parameter_refusal(adapter: AuditedAdapter, name: str) -> str | None:
    graph = adapter.graph
    if name not in graph.parameters:
        return f"The parameter {name} no longer exists."
    if (words := parameter_denied_reason(graph, name)) is not None:
        return words
    if Operation.SET_PARAMETER in adapter.allows(Ref(Kind.PARAMETER, name)):
        return None
    return f"The parameter {name} of this {adapter.capabilities.system} cannot be set."


def _topic_refusal(adapter: AuditedAdapter, permitted: tuple[str, ...], writer: TopicSource) -> str | None:
    graph = adapter.graph
    topic = graph.topics.get(writer.name)
    if topic is None:
        return f"The topic {writer.name} no longer exists."
    if writer.schema is None:
        return f"The type of {writer.name} is not known."
    if Operation.PUBLISH not in adapter.allows(Ref(Kind.TOPIC, writer.name)):
        return f"Nothing can be published on {writer.name} of a {adapter.capabilities.system}."
    return denied_reason(topic, graph, permitted)


# The plan


def plan_write(session: Session, property: Property, content: object, *, defaults: bool = False) -> PlannedWrite:
    """Return the plan for setting a property to `content` (plain JSON or an RDF literal), without side effects.

    Missing fields have their `defaults`, or are violations. Raises a 405 Problem if nothing can write the property now,
    and LoweringError for an invalid content; the `path` of a violation is "" for a scalar.
    """
    writer = current_writer(session.adapter, session.settings, property)
    match writer:
        case Setter(schema=service):
            return _plan_message(session, property, writer, service.request, content, defaults)
        case TopicSource(schema=schema) if schema is not None:
            return _plan_message(session, property, writer, schema, content, defaults)
        case ParameterSource():
            parameter = session.graph.parameters.get(writer.name)
            if isinstance(content, Literal):
                require_form(None if parameter is None else parameter.descriptor, content)
            return PlannedWrite(property.name, writer, StoredValue(_parameter_value(property.shape, content)))
        case _:
            reason = not_writable_reason(session.adapter, session.settings, property)
            raise Problem(405, reason, about=not_writable_about(session, property))


def _parameter_value(shape: ValueShape, content: object) -> ParameterValue:
    """Return the value of a parameter. ROS declares no type for it, but a reader of the property may have one."""
    value = lower_term(content) if isinstance(content, Literal) else lower_json(content)
    match shape:
        case ScalarShape(kind):
            fitted = _fit(kind, content)
            return fitted if isinstance(fitted, bool | int | float) else value
        case MessageShape(schema, fields):
            lowerer(select_fields(schema, fields)).from_json(content)
    return value


def _fit(kind: Primitive, content: object) -> object:
    """Return a content as a primitive. Raises LoweringError if it is invalid."""
    try:
        return term_leaf(kind)(content) if isinstance(content, Literal) else json_leaf(kind)(content)
    except Misfit as misfit:
        raise LoweringError(Violation("", misfit.words, brief_value(misfit.value))) from misfit


def _plan_message(
    session: Session, property: Property, writer: Writer, schema: MessageSchema, content: object, defaults: bool
) -> PlannedWrite:
    message = lower_content(schema, content, session.lifting, defaults=defaults)
    data = schema.codec.encode(message, session.adapter.capabilities.encoding)
    url = session.space.service(writer.name) if isinstance(writer, Setter) else session.space.topic(writer.name)
    return PlannedWrite(property.name, writer, MessageValue(schema, message, schema.type.fields, url), data)


def lower_content(schema: MessageSchema, content: object, lifting: LiftSettings, *, defaults: bool = False) -> Message:
    """Return the message of `schema` with a content: in its one field if that is a scalar, else field by field.

    Missing fields have their `defaults`, or are violations. Raises LoweringError for an invalid content.
    """
    field = scalar_field(schema.type.fields)
    if isinstance(content, Literal):
        return _from_literal(schema, field, content, lifting)
    lowering = lowerer(schema, lifting)
    if field is None or (isinstance(content, dict) and content.keys() == {field.name}):
        return lowering.from_json(content, defaults=defaults)
    try:
        return lowering.from_json({field.name: content})
    except LoweringError as error:
        raise LoweringError(*(replace(each, path="") for each in error.violations)) from error


def _from_literal(schema: MessageSchema, field: Field | None, content: Literal, lifting: LiftSettings) -> Message:
    if field is None:
        expected = f"expected a node of type <{lifting.types}{schema.ref.name}>"
        raise LoweringError(Violation("", expected, brief_value(content)))
    value = _fit(cast(Primitive, field.type), content)
    return schema.codec.build(schema.ref.name, {field.attribute: value})


# Execution


async def carry_out(session: Session, planned: PlannedWrite) -> WriteOutcome:
    """Carry out a planned write. Raises RosError as the adapter does, and Refused if the setter refuses."""
    writer, value = planned.writer, planned.value
    match writer:
        case Setter():
            await _call(session, writer, planned.data)
        case TopicSource():
            assert isinstance(value, MessageValue)
            publication = prepare(session, writer.name, value.schema, value.message, planned.data)
            published = await publish(session, publication)
            if not published.matched:
                return WriteOutcome.UNHEARD
            return WriteOutcome.GOES_ON if publication.goes_on else WriteOutcome.DONE
        case ParameterSource():
            assert isinstance(value, StoredValue)
            return await _set(session, writer.name, value.value)
    return WriteOutcome.DONE


async def _set(session: Session, name: str, value: ParameterValue) -> WriteOutcome:
    deadline = loop_time() + session.settings.call_deadline
    try:
        await session.adapter.set_parameters({name: value}, deadline=deadline)
    finally:
        session.announce_write(Kind.PARAMETER, name)
    deadline = loop_time() + session.settings.call_deadline
    is_other = await has_other_values(session.adapter, {name: value}, deadline=deadline)
    return WriteOutcome.OTHERWISE if is_other else WriteOutcome.DONE


async def _call(session: Session, setter: Setter, request: bytes) -> None:
    deadline = loop_time() + session.settings.call_deadline
    response = setter.schema.response
    try:
        answer = await session.adapter.call(setter.name, setter.schema.ref, request, deadline=deadline)
    finally:
        session.announce_write(Kind.SERVICE, setter.name)
    with errors_about(source_url(setter, session.space)):
        try:
            message = response.codec.decode(answer, session.adapter.capabilities.encoding)
        except ValueError as error:
            raise UnreadableResponse(f"the response of {setter.name} cannot be read: {error}", sent=Sent.YES) from error
        words = refusal_text(response, message)
        if words is not None:
            raise Refused(f"{setter.name} refused the value", words=words or None, sent=Sent.YES)
