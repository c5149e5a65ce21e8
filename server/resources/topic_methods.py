"""The methods of topics, their requests, and why nothing may be published."""

from __future__ import annotations

import re
from collections.abc import Mapping

from rosld.adapters.model import Graph, Kind, MessageSchema, Operation, Ref, Topic
from rosld.ontology.urls import Space
from rosld.server.hypermedia.json_schema import OBJECT, MessageSchemas, message_schema, patch_schema
from rosld.server.resources.holds import hold_parameters, hold_schema
from rosld.server.resources.limit_checks import STRICTNESS
from rosld.server.resources.namespaces import is_absent
from rosld.server.rest.path_item import QueryParameter, WriteMethod
from rosld.server.rest.resource import READ
from rosld.server.robot.session import Session
from rosld.server.robot.write_policy import RESERVED, denied_reason, resources_only_reason

_LEGAL = re.compile(r"(/[A-Za-z][A-Za-z0-9_]*)+")
"""The names of topics that both ROS 1 and ROS 2 allow."""
_LATCH = QueryParameter("latch", "Whether subscribers that come later get the message.", {"type": "boolean"})


def write_refusal(session: Session, name: str) -> str | None:
    """Why nothing may be published on the topic of a name, in a sentence; None where it may, and may be made."""
    topic = session.graph.topics.get(name)
    if session.settings.read_only:
        return "This server is read-only."
    if session.is_resources_only(name):
        return resources_only_reason(name)
    if Operation.PUBLISH not in session.adapter.allows(Ref(Kind.TOPIC, name)):
        return f"Nothing can be published on {name} of a {session.adapter.capabilities.system}."
    if topic is not None:
        return denied_reason(topic, session.graph, session.settings.allow_publish)
    if name in RESERVED and name not in session.settings.allow_publish:
        return f"{name} belongs to ROS itself."
    return None if _LEGAL.fullmatch(name) else f"{name!r} is no legal name for a new topic."


def topic_methods(space: Space, graph: Graph, name: str, *, can_write: bool) -> frozenset[str]:
    """Return the allowed methods of a topic; for a missing topic, those that create it."""
    methods = READ | _writing_methods(graph, name) if can_write else READ
    is_there = not is_absent(space, graph, "topics", name)
    return methods if is_there else methods - {"GET", "HEAD"}


def _writing_methods(graph: Graph, name: str) -> frozenset[str]:
    topic = graph.topics.get(name)
    if topic is None:
        return frozenset({"PUT"})
    is_advertised = any(endpoint.node == graph.own_node for endpoint in topic.publishers)
    methods = frozenset({"PUT", "PATCH"} if topic.type is None else {"PUT", "PATCH", "POST"})
    return methods | {"DELETE"} if is_advertised else methods


def topic_writes(
    topic: Topic | None,
    schema: MessageSchema | None,
    schemas: MessageSchemas,
    *,
    commands_velocity: bool,
    hold_time: float,
) -> Mapping[str, WriteMethod]:
    """What each method that writes to a topic does and takes, for the description of the API.

    `topic` is None for one that is not there, `schema` where the type of its messages is not known; `hold_time` is the
    longest that a hold may be asked to last.
    """
    sent = schemas.write(schema)
    publishes = "Publishes a message."
    if topic is None:
        publishes = "Makes a topic that is not there yet: RDF that states the type of the message."
    return {
        "PUT": WriteMethod(publishes, sent, done=(200, 201, 202, 204), query=(*STRICTNESS, _LATCH)),
        "PATCH": WriteMethod(
            "Publishes the latest message with changes.",
            OBJECT if schema is None else patch_schema(message_schema(schema, schemas.lifting, read=False, sent=True)),
            done=(200, 202, 204),
            query=(_LATCH,),
        ),
        "POST": WriteMethod(
            "Holds the topic: publishes the message `rate` times a second while the lease is renewed, or `for` a time.",
            sent,
            done=(201,),
            shows=hold_schema(schemas, schema),
            query=(*STRICTNESS, *hold_parameters(hold_time, "" if commands_velocity else "rate")),
        ),
        "DELETE": WriteMethod(
            "Stops to advertise the topic; 405 while this server does not advertise it.", done=(204,)
        ),
    }
