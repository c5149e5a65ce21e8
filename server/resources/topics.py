"""Topics: read as their latest messages, written by publishing (paper, Table 2; DESIGN section 3)."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

from pyoxigraph import NamedNode
from starlette.responses import Response

from rosld.adapters.model import Graph, Kind, Message, MessageSchema, Operation, Ref, RosError, Sample, Topic, TypeRef
from rosld.ontology.body import RdfBody, parse_body
from rosld.ontology.describe_topics import topic_document
from rosld.ontology.document import Document, Envelope, LiftedMessage
from rosld.ontology.fields import field_bytes
from rosld.ontology.lift import LiftSettings, lifter
from rosld.ontology.lower import find_message, lowerer, parse_json
from rosld.ontology.vocab import rdf, ros
from rosld.server.html import DeleteForm, Form, MessageForm
from rosld.server.html.inputs import Json
from rosld.server.http.conditional import require_if_match
from rosld.server.http.problem import Problem, render
from rosld.server.ldp.exchange import Exchange
from rosld.server.ldp.patch import merge_patch, updated
from rosld.server.ldp.resource import JSON, MERGE_PATCH, RDF_BODIES, READ, SPARQL_UPDATE, Answer, Resource
from rosld.server.ldp.state import State, digest
from rosld.server.live.view import View
from rosld.server.resources.namespaces import moved_to_namespace
from rosld.server.robot import Robot, Same
from rosld.server.writable import RESERVED, refusal

_LEGAL = re.compile(r"(/[A-Za-z][A-Za-z0-9_]*)+")
_WHOLE = 1 << 62


@dataclass(frozen=True, slots=True)
class Publish:
    """A planned publish: everything that could be refused has been looked at."""

    topic: str
    type: TypeRef
    data: bytes
    latch: bool
    creates: bool


@dataclass(frozen=True, slots=True)
class Decoded:
    """A sample with its message, or with the reason why it cannot be read."""

    sample: Sample
    schema: MessageSchema | None
    message: Message | None
    reason: str | None = None


class TopicResource(Resource):
    """One topic."""

    kind = "Topic"
    accepts: Mapping[str, Sequence[str]] = {"PUT": (*RDF_BODIES, JSON), "PATCH": (MERGE_PATCH, SPARQL_UPDATE)}

    def __init__(self, robot: Robot, name: str) -> None:
        super().__init__(robot.space.topic(name))
        self.title = name
        self.robot = robot
        self.name = name
        self._allowed: tuple[Graph, frozenset[str], str | None] | None = None

    @property
    def topic(self) -> Topic | None:
        """The topic in the computation graph, None where there is none of that name."""
        return self.robot.graph.topics.get(self.name)

    def methods(self) -> frozenset[str]:
        return self._allowance()[1]

    def why_unwritable(self) -> str | None:
        """Why nothing may be published here, in a sentence; None where it may."""
        return self._allowance()[2]

    def _allowance(self) -> tuple[Graph, frozenset[str], str | None]:
        """The verbs and the refusal in the graph as it is: found once a graph."""
        graph = self.robot.graph
        if self._allowed is None or self._allowed[0] is not graph:
            refusal = self._refusal()
            self._allowed = (graph, READ if refusal else self._writing(), refusal)
        return self._allowed

    def _writing(self) -> frozenset[str]:
        topic = self.topic
        if topic is None:
            return READ | {"PUT"}
        own = any(endpoint.node == self.robot.graph.own_node for endpoint in topic.publishers)
        return READ | {"PUT", "PATCH", "DELETE"} if own else READ | {"PUT", "PATCH"}

    def _refusal(self) -> str | None:
        robot, topic = self.robot, self.topic
        if robot.settings.read_only:
            return "This server is read-only."
        if Operation.PUBLISH not in robot.adapter.allows(Ref(Kind.TOPIC, self.name)):
            return f"Nothing can be published on {self.name} of a {robot.adapter.capabilities.system}."
        if topic is not None:
            return refusal(topic, robot.graph, robot.settings.allow_publish)
        if self.name in RESERVED and self.name not in robot.settings.allow_publish:
            return f"{self.name} belongs to ROS itself."
        return None if _LEGAL.fullmatch(self.name) else f"{self.name!r} is no legal name for a new topic."

    def why_not(self, method: str) -> str:
        if method == "DELETE" and self.why_unwritable() is None:
            return f"rosld does not advertise {self.name}, so there is nothing to delete."
        return self.why_unwritable() or super().why_not(method)

    async def state(self) -> State:
        robot = self.robot
        view = robot.topics.peek(self.name)
        if view is None:
            if self.name not in robot.graph.topics:
                raise moved_to_namespace(robot, "topics", self.name) or Problem(404, f"There is no topic {self.name}.")
            view = await robot.topics.look(self.name)
        topic = robot.graph.topics.get(self.name) or Topic(self.name)
        graph = robot.graph
        version = (Same(topic), Same(view), graph.simulated_time)
        known = robot.states.known(self.url, version)
        if known is None:
            decoded = [await decode(robot, sample) for sample in view.samples]
            known = robot.states.keep(self.url, version, self._state(topic, view, decoded))
        return known

    def _state(self, topic: Topic, view: View, decoded: Sequence[Decoded]) -> State:
        newest = decoded[-1] if decoded else None

        def plain() -> bytes:
            if newest is None:
                return b"null"
            if newest.schema is None or newest.message is None:
                raise Problem(406, f"The messages of {self.name} cannot be read: {newest.reason}.")
            return lifter(newest.schema, self.robot.lifting).json(newest.message, self.url)

        token = digest(f"{topic!r}{view.identity()}{[one.reason for one in decoded]}".encode("utf-8", "replace"))
        recorded = bool(self.robot.adapter.recordings)  # a recording's times are of the past: no Age (RFC 9111 5.1)
        received = view.newest.received_ns if view.newest and not recorded else None
        return State(lambda: self._document(topic, view, decoded), plain, token, received)

    def _document(self, topic: Topic, view: View, decoded: Sequence[Decoded]) -> Document:
        robot = self.robot
        found = [lifted(robot, one) for one in decoded if one.message is not None]
        reason = next((one.reason for one in decoded if one.reason), topic.unreadable)
        return topic_document(topic, robot.space, robot.graph, view.rate, found, unreadable=reason)

    @property
    def constrained_by(self) -> str | None:
        topic = self.topic
        return None if topic is None or topic.type is None else self.robot.space.shape(topic.type.name)

    async def forms(self) -> Sequence[Form]:
        methods, topic = self.methods(), self.topic
        forms: list[Form] = []
        if "PUT" in methods and topic is not None and topic.type is not None:
            try:
                schema = await self.robot.schemas.message(topic.type)
                forms.append(MessageForm(schema, value=await self._latest_json()))
            except RosError:
                pass
        if "DELETE" in methods:
            forms.append(DeleteForm("Stop advertising", "Stop advertising", f"rosld no longer publishes {self.name}."))
        return forms

    async def _latest_json(self) -> Json:
        """The latest message as plain JSON, None where there is none that can be read."""
        view = self.robot.topics.peek(self.name)
        if view is None or view.newest is None:
            return None
        decoded = await decode(self.robot, view.newest)
        if decoded.schema is None or decoded.message is None:
            return None
        return cast(Json, parse_json(lifter(decoded.schema, self.robot.lifting).json(decoded.message, self.url)))

    async def special(self, exchange: Exchange) -> Response | None:
        """`?field=PATH`: the bytes of one field of the latest message."""
        if b"field=" not in exchange.request.scope["query_string"] or "field" not in exchange.query:
            return None
        view = await self.robot.topics.look(self.name)
        if view.newest is None:
            raise Problem(404, f"{self.name} has no message yet, so no field {exchange.query['field']!r}.")
        return await field_response(self.robot, view.newest, exchange.query["field"])

    async def put(self, exchange: Exchange) -> Answer:
        return await self._carry_out(await self._plan(exchange), exchange)

    async def patch(self, exchange: Exchange) -> Answer:
        require_if_match(exchange.header("if-match"), "PATCH changes the latest message, which changes often.")
        return await self._carry_out(await self._plan_patch(exchange), exchange)

    async def delete(self, exchange: Exchange) -> Answer:
        await self.robot.adapter.unadvertise(self.name)
        return Response(status_code=204)

    async def _plan(self, exchange: Exchange) -> Publish:
        """Parse, find the type, lower and encode: nothing moves."""
        data = await exchange.body()
        latch = exchange.flag("latch")
        if exchange.media_type == JSON:
            if self.topic is None:
                raise Problem(
                    404, f"There is no topic {self.name}; to make it, PUT RDF that states the message's type."
                )
            schema = await self._schema()
            message = lowerer(schema, self.robot.lifting).from_json(
                parse_json(data), defaults=exchange.flag("defaults")
            )
            return self._publish(schema, message, latch)
        body = parse_body(data, exchange.media_type, self.url)
        schema = await (self._schema() if self._typed() else self._stated_schema(body))
        return self._publish(schema, self._lower(schema, body), latch)

    async def _plan_patch(self, exchange: Exchange) -> Publish:
        view = await self.robot.topics.look(self.name)
        if view.newest is None:
            raise Problem(409, f"{self.name} has no message yet that a PATCH could change; PUT one.")
        data = await exchange.body()
        base = await decode(self.robot, view.newest)
        if base.schema is None or base.message is None:
            raise Problem(409, f"The latest message of {self.name} cannot be read: {base.reason}.")
        whole = lifter(base.schema, LiftSettings(self.robot.lifting.types, _WHOLE))
        if exchange.media_type == MERGE_PATCH:
            patched = merge_patch(parse_json(whole.json(base.message, self.url)), parse_json(data))
            message = lowerer(base.schema, self.robot.lifting).from_json(patched)
        else:
            before = [*(await self.state()).document.triples, *whole.triples(base.message, self.url, "#message")]
            message = self._lower(base.schema, updated(data, before, self.url))
        return self._publish(base.schema, message, exchange.flag("latch"))

    def _publish(self, schema: MessageSchema, message: Message, latch: bool) -> Publish:
        data = schema.codec.encode(message, self.robot.adapter.capabilities.encoding)
        return Publish(self.name, schema.ref, data, latch, creates=self.topic is None)

    def _lower(self, schema: MessageSchema, body: RdfBody) -> Message:
        self._check_stable(body)
        root = find_message(body, self.url, self.robot.space.class_of(schema.ref.name))
        return lowerer(schema, self.robot.lifting).from_graph(body, root, self.url)

    def _check_stable(self, body: RdfBody) -> None:
        """What the server says of a topic may be repeated, not changed (409)."""
        about = NamedNode(self.url)
        if about not in body.subjects:
            return
        said = {ros.name: self.name}
        topic = self.topic
        if topic is not None and topic.type is not None:
            said[ros.messageType] = self.robot.space.class_of(topic.type.name)
        for predicate, value in said.items():
            for term in body.objects(about, predicate):
                if getattr(term, "value", None) != value:
                    raise Problem(409, f"The {predicate.value} of {self.name} is {value!r} and cannot become {term}.")

    def _typed(self) -> bool:
        return self.topic is not None and bool(self.topic.types)

    async def _schema(self) -> MessageSchema:
        topic = self.topic
        if topic is None or topic.type is None:
            raise Problem(409, f"The type of {self.name} is not known; PUT RDF that states the message's type.")
        return await self.robot.schemas.message(topic.type)

    async def _stated_schema(self, body: RdfBody) -> MessageSchema:
        """The schema of the type that the body states: of `#message`, or the topic's `ros:messageType`."""
        base = self.robot.space.types
        stated = [
            *body.objects(NamedNode(f"{self.url}#message"), rdf.type),
            *body.objects(NamedNode(self.url), ros.messageType),
            *(term for subject in body.subjects for term in body.objects(subject, rdf.type)),
        ]
        for term in stated:
            if isinstance(term, NamedNode) and term.value.startswith(base):
                return await self.robot.schemas.message(TypeRef(term.value[len(base) :]))
        raise Problem(422, f"{self.name} has no type yet, and the body states none: give the message a type of {base}.")

    async def _carry_out(self, plan: Publish, exchange: Exchange) -> Response:
        robot = self.robot
        wait = robot.limiter.wait(plan.topic, asyncio.get_running_loop().time())
        if wait > 0:
            sentence = f"More than {robot.limiter.rate:g} messages a second on {plan.topic} (--max-publish-rate)."
            raise Problem(429, sentence, headers={"Retry-After": str(max(1, round(wait)))})
        deadline = robot.deadline(robot.settings.publish_wait)
        published = await robot.adapter.publish(plan.topic, plan.type, plan.data, latch=plan.latch, deadline=deadline)
        if plan.creates:
            return Response(status_code=201, headers={"Location": self.url})
        if published.matched == 0:
            sentence = f"The message was published, but no subscriber of {plan.topic} was there to get it."
            return render(Problem(202, sentence, title="Nobody is listening"), exchange.accept).response()
        return Response(status_code=204)


async def decode(robot: Robot, sample: Sample) -> Decoded:
    """A sample's message, or why it cannot be read."""
    try:
        schema = await robot.schemas.message(sample.schema)
        return Decoded(sample, schema, schema.codec.decode(sample.data, sample.encoding))
    except (RosError, ValueError) as error:
        return Decoded(sample, None, None, str(error))


def lifted(robot: Robot, one: Decoded) -> LiftedMessage:
    """A decoded sample as the `#message` of a document."""
    assert one.schema is not None
    assert one.message is not None
    publisher = robot.space.node(one.sample.publisher) if one.sample.publisher else None
    envelope = Envelope(one.sample.received_ns, one.sample.sequence, publisher)
    return LiftedMessage("#message", lifter(one.schema, robot.lifting), one.message, envelope)


async def field_response(robot: Robot, sample: Sample, path: str) -> Response:
    """The bytes of one field of a message; a 404 Problem where it has none of that path."""
    decoded = await decode(robot, sample)
    if decoded.schema is None or decoded.message is None:
        raise Problem(406, f"The message cannot be read: {decoded.reason}.")
    try:
        data, media_type = field_bytes(decoded.schema, decoded.message, path)
    except ValueError as error:
        raise Problem(404, str(error)) from error
    return Response(data, media_type=media_type, headers={"Cache-Control": "no-cache"})
