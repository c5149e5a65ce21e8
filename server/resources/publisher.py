"""Publishing: a body becomes a plan, with all checks, and the plan is then carried out on the robot."""

from __future__ import annotations

from collections.abc import Sequence

from pyoxigraph import NamedNode, Triple
from starlette.responses import Response

from rosld.adapters.model import Kind, Message, MessageSchema, Topic, TypeRef, UnknownType
from rosld.ontology.body import RdfBody, index_triples, parse_body, parse_json
from rosld.ontology.lift import lifter
from rosld.ontology.lower import lowerer
from rosld.ontology.neutral_message import COMMANDS
from rosld.ontology.urls import Space
from rosld.ontology.vocab import rdf, rdfs, ros
from rosld.server.http.problem import Problem
from rosld.server.http.problem_details import render
from rosld.server.patches.patch import apply_update, merge_patch
from rosld.server.resources.limit_checks import is_strict
from rosld.server.resources.messages import decode
from rosld.server.resources.named_resource import NamedResource
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import JSON, MERGE_PATCH
from rosld.server.robot.publication import (
    Publication,
    goes_on_link,
    goes_on_problem,
    no_subscriber_problem,
    prepare,
    publish,
)


def goes_on_response(exchange: Exchange, topic: str, topic_url: str) -> Response:
    """Return the answer to a velocity published once: 204 with a link to the way to hold it.

    A client that accepts specific types and prefers no other answer receives 200 with a warning as the body.
    """
    is_silent = exchange.accept is None or exchange.accept.strip() == "*/*"
    if is_silent or exchange.prefer.minimal or exchange.prefer.representation:
        return Response(status_code=204, headers={"Link": str(goes_on_link(topic_url))})
    return render(goes_on_problem(topic, topic_url), exchange.accept).response()


class PublishingResource(NamedResource[Topic]):
    """A topic on which messages are published. `plan` and `plan_patch` only parse, lower and encode."""

    kind = shape = "Topic"
    ros_kind = Kind.TOPIC
    url_of = Space.topic

    @property
    def commands_velocity(self) -> bool:
        """Whether the messages of the topic are velocity commands."""
        topic = self.found
        return topic is not None and topic.type is not None and topic.type.name in COMMANDS

    async def plan(self, exchange: Exchange) -> Publication:
        """Plan a PUT. Raises LoweringError, BodyError, and Problems for all refusals."""
        schema, message = await self.read_message(exchange)
        return await self._publication(schema, message, latch=exchange.query_flag("latch"))

    async def read_message(self, exchange: Exchange) -> tuple[MessageSchema, Message]:
        """Return the schema and the message of a body sent to the topic. Raises LoweringError and Problems."""
        data, topic = await exchange.body(), self.found
        if exchange.media_type == JSON:
            if topic is None:
                raise Problem(
                    404, f"There is no topic {self.name}; to create it, PUT RDF that states the message type."
                )
            schema = await self._schema(topic)
            return schema, self._from_json(exchange, schema, data)
        body = parse_body(data, exchange.media_type, self.url)
        schema = await self._schema_for(topic, body)
        return schema, await self._lower(topic, schema, body)

    async def message_of(self, exchange: Exchange, schema: MessageSchema, url: str) -> Message:
        """Return the message of this schema in a body sent to `url`. Raises LoweringError and Problems."""
        data = await exchange.body()
        if exchange.media_type == JSON:
            return self._from_json(exchange, schema, data)
        body = parse_body(data, exchange.media_type, url)
        await self.limit_checks.require_text(Kind.TOPIC, self.name, schema, body)
        return lowerer(schema, self.session.lifting).from_body(body, url)

    def _from_json(self, exchange: Exchange, schema: MessageSchema, data: bytes) -> Message:
        lowering = lowerer(schema, self.session.lifting)
        return lowering.from_json(parse_json(data), defaults=not is_strict(exchange))

    async def require_within_limits(self, schema: MessageSchema, message: Message) -> None:
        """Raise a LoweringError if a message violates the limits of the topic."""
        await self.limit_checks.require_message(Kind.TOPIC, self.name, schema, message)

    async def plan_graph(self, triples: Sequence[Triple]) -> Publication:
        """Return the publication that gives the graph of the topic these triples.

        `#message` has the topic's type by default.
        """
        topic, body, node = self.found, index_triples(triples), NamedNode(f"{self.url}#message")
        schema = await self._schema_for(topic, body)
        if node in body.subjects and not body.objects(node, rdf.type):
            class_ = NamedNode(self.session.space.class_of(schema.ref.name))
            body = index_triples([*triples, Triple(node, rdf.type, class_)])
        message = await self._lower(topic, schema, body)
        return await self._publication(schema, message)

    async def plan_patch(self, exchange: Exchange, description: Sequence[Triple]) -> Publication:
        """Return the publication of the patched latest message; `description` holds the triples of the topic itself.

        Raises a 409 Problem if there is no message to patch, other Problems for the patch, and LoweringError.
        """
        view = await self.session.topics.read(self.name)
        if view.newest is None:
            raise Problem(409, f"{self.name} has no message to PATCH yet; PUT one.")
        data, topic = await exchange.body(), self.found
        base = await decode(self.session.schemas, view.newest)
        if base.schema is None or base.message is None:
            raise Problem(409, f"The latest message of {self.name} cannot be read: {base.reason}.")
        whole = lifter(base.schema, self.session.lifting.unelided)
        if exchange.media_type == MERGE_PATCH:
            patched = merge_patch(parse_json(whole.json(base.message, self.url)), parse_json(data))
            message = lowerer(base.schema, self.session.lifting).from_json(patched)
        else:
            before = [*description, *whole.triples(base.message, self.url, "#message")]
            message = await self._lower(topic, base.schema, apply_update(data, before, self.url, by_value=True))
        return await self._publication(base.schema, message, latch=exchange.query_flag("latch"))

    async def _publication(self, schema: MessageSchema, message: Message, *, latch: bool = False) -> Publication:
        await self.require_within_limits(schema, message)
        data = schema.codec.encode(message, self.session.adapter.capabilities.encoding)
        # The robot may have been stopped while the body was read.
        return prepare(self.session, self.name, schema, message, data, latch=latch)

    async def _lower(self, topic: Topic | None, schema: MessageSchema, body: RdfBody) -> Message:
        self._check_stable(topic, body)
        await self.limit_checks.require_text(Kind.TOPIC, self.name, schema, body)
        return lowerer(schema, self.session.lifting).from_body(body, self.url)

    def _check_stable(self, topic: Topic | None, body: RdfBody) -> None:
        """Raise a 409 Problem for a changed server-managed statement about a topic; unchanged ones are allowed."""
        about = NamedNode(self.url)
        if about not in body.subjects:
            return
        statements = {ros.name: self.name, rdfs.label: self.name}
        if topic is not None and topic.type is not None:
            statements[ros.hasMessageType] = self.session.space.class_of(topic.type.name)
        for predicate, value in statements.items():
            for term in body.objects(about, predicate):
                if getattr(term, "value", None) != value:
                    raise Problem(409, f"The {predicate.value} of {self.name} is {value!r} and cannot become {term}.")

    async def _schema_for(self, topic: Topic | None, body: RdfBody) -> MessageSchema:
        """Return the schema of the topic's type, or of the type that the body states for a topic without one."""
        has_type = topic is not None and bool(topic.types)
        return await (self._schema(topic) if has_type else self._stated_schema(body))

    async def _schema(self, topic: Topic | None) -> MessageSchema:
        if topic is None or topic.type is None:
            raise Problem(409, f"The type of {self.name} is not known; PUT RDF that states the message type.")
        try:
            return await self.session.schemas.message(topic.type)
        except UnknownType as error:
            raise Problem(409, f"Nothing can be published on {self.name}: {error.sentence}.") from error

    async def _stated_schema(self, body: RdfBody) -> MessageSchema:
        """Return the schema of the type that the body states for `#message` or as `ros:hasMessageType`."""
        base = self.session.space.types
        stated = [
            *body.objects(NamedNode(f"{self.url}#message"), rdf.type),
            *body.objects(NamedNode(self.url), ros.hasMessageType),
            *(term for subject in body.subjects for term in body.objects(subject, rdf.type)),
        ]
        for term in stated:
            if isinstance(term, NamedNode) and term.value.startswith(base):
                try:
                    return await self.session.schemas.message(TypeRef(term.value[len(base) :]))
                except UnknownType as error:
                    raise Problem(422, f"{error.sentence}.") from error
        raise Problem(422, f"{self.name} has no type yet, and neither has the body: give the message a type of {base}.")

    async def carry_out(self, publication: Publication, exchange: Exchange) -> Response:
        """Publish: 201 if that creates the topic, 202 if there is no subscriber, else 204. Raises RosError.

        For a velocity that stays in effect, a client that accepts specific types receives 200 with a warning.
        """
        is_new = self.found is None
        published = await publish(self.session, publication)
        if is_new:
            return Response(status_code=201, headers={"Location": self.url})
        if published.matched == 0:
            return render(no_subscriber_problem(self.name), exchange.accept).response()
        if publication.goes_on:
            return goes_on_response(exchange, self.name, self.url)
        return Response(status_code=204)
