"""Services and their calls: POST calls a service and creates a call as a resource."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from operator import attrgetter
from typing import ClassVar, Generic, TypeVar

import orjson
from starlette.responses import Response

from rosld.adapters.model import (
    Action,
    ActionSchema,
    Kind,
    Message,
    MessageSchema,
    Operation,
    Refused,
    RosError,
    Sent,
    Service,
    ServiceSchema,
    TypeRef,
    UnknownType,
)
from rosld.ontology.body import parse_body, parse_json
from rosld.ontology.describe_services import CallView, call_document, service_document
from rosld.ontology.document import Document
from rosld.ontology.lift import lifter
from rosld.ontology.literals import date_time
from rosld.ontology.lower import lowerer
from rosld.ontology.urls import Space
from rosld.server.html.forms import DeleteForm, Form, message_form
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import ANYTHING, TEXT, URI, JsonSchema, MessageSchemas, json_object, nullable
from rosld.server.hypermedia.value import refusal_text
from rosld.server.receipts.audit import Sender
from rosld.server.resources.accepted_shape import message_shape, shape_query
from rosld.server.resources.limit_checks import NODES, STRICTNESS, is_strict
from rosld.server.resources.named_resource import KeptResource, NamedResource
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import JSON, RDF_BODIES
from rosld.server.rest.path_item import PathItem, WriteMethod
from rosld.server.rest.resource import READ, Answer, CreatedAnswer
from rosld.server.rest.responses import offer_url
from rosld.server.rest.ros_problems import problem_of
from rosld.server.rest.state import EndedState, State
from rosld.server.robot.calls import Call, CallOutcome, CallState
from rosld.server.runtime.tasks import loop_time
from rosld.server.runtime.version_cache import IdentityKey

_CALL: JsonSchema = json_object(
    optional={
        **dict.fromkeys(("id", "service", "state"), TEXT),
        **{name: nullable(TEXT) for name in ("sentBy", "ended", "words")},
        "url": URI,
        "offer": URI,
    }
)


Schema = TypeVar("Schema", bound=ServiceSchema | ActionSchema)
Thing = TypeVar("Thing", bound=Service | Action)


class InvocableResource(NamedResource[Thing], Generic[Thing, Schema]):
    """Base class of services and actions: a POST sends the robot a request or a goal."""

    accepts: Mapping[str, Sequence[str]] = {"POST": (*RDF_BODIES, JSON)}
    operation: Operation
    usage: str
    """Beginning of the message of a 405 Problem, which says what POST does."""
    cannot: str
    """Template of the sentence that nothing can be sent to a name now."""
    form: tuple[str, str]
    """The title and the button of the form."""

    def find_schema(self, type: TypeRef) -> Awaitable[Schema]:
        """Return the schema of a type. Raises UnknownType."""
        raise NotImplementedError

    def part(self, schema: Schema) -> MessageSchema:
        """Return the schema of the message to send."""
        raise NotImplementedError

    def unusable(self, found: Thing) -> str | None:
        """Return a sentence why nothing can be sent, or None if it can."""
        raise NotImplementedError

    def methods(self) -> frozenset[str]:
        return READ | {"POST"} if self.allows(self.operation) else READ

    def deny_reason(self, method: str) -> str:
        if method != "POST" and not self.session.settings.read_only:
            return f"{self.usage} with POST; it does not support {method}."
        return self.closed_reason or self.unusable(self.require()) or f"{self.cannot.format(self.name)}."

    @property
    def constrained_by(self) -> str | None:
        found = self.found
        return None if found is None or found.type is None else shape_query(self.url)

    async def accepted(self, url: str) -> Document | None:
        schema = self.part(await self.schema())
        return await message_shape(self.limit_checks, self.ros_kind, self.name, schema, url)

    async def forms(self) -> Sequence[Form]:
        if "POST" not in self.methods():
            return ()
        try:
            schema = self.part(await self.schema())
            bounds = await self.limit_checks.message_bounds(self.ros_kind, self.name, schema)
            return (message_form(schema, "POST", *self.form, bounds=bounds),)
        except (Problem, RosError):
            return ()

    async def schema(self) -> Schema:
        """Return the schema of the type. Raises a 409 Problem if it is unknown."""
        found, cannot = self.require(), self.cannot.format(self.name)
        if found.type is None:
            raise Problem(409, f"{cannot}: {self.unusable(found) or 'its type is not known'}.")
        try:
            return await self.find_schema(found.type)
        except UnknownType as error:
            raise Problem(409, f"{cannot}: {error.sentence}") from error

    async def read_message(self, exchange: Exchange, url: str, schema: Schema) -> Message:
        """Return the request or goal in a body sent to `url`, checked against the limits.

        An empty body is valid only for a message without fields, so that a lost body does not move the robot; `{}`
        stands for the defaults. Raises BodyError, LoweringError and Problems.
        """
        data, sent = await exchange.body(), self.part(schema)
        lowering = lowerer(sent, self.session.lifting)
        if not data.strip():
            message = lowering.from_json({}, defaults=exchange.query_flag("defaults"))
        elif exchange.media_type == JSON:
            message = lowering.from_json(parse_json(data), defaults=not is_strict(exchange))
        else:
            body = parse_body(data, exchange.media_type, url)
            await self.limit_checks.require_text(self.ros_kind, self.name, sent, body)
            message = lowering.from_body(body, url, NODES[self.ros_kind])
        await self.limit_checks.require_message(self.ros_kind, self.name, sent, message)
        return message


class ServiceResource(InvocableResource[Service, ServiceSchema]):
    """One service."""

    kind = shape = "Service"
    ros_kind = Kind.SERVICE
    url_of = Space.service
    operation = Operation.CALL
    usage = "A service is called"
    cannot = "{} cannot be called"
    form = ("Call the service", "Call")

    def find_schema(self, type: TypeRef) -> Awaitable[ServiceSchema]:
        return self.session.schemas.service(type)

    def part(self, schema: ServiceSchema) -> MessageSchema:
        return schema.request

    def unusable(self, found: Service) -> str | None:
        return found.uncallable

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        type = self.require().type
        schema = schemas.find(type, ServiceSchema)
        call = WriteMethod(
            "Calls the service, once per `Idempotency-Key`.",
            schemas.write(schema.request if schema else None),
            "With the response: 201 and the service's answer.",
            is_body_required=False,
            done=(201,),
            shows=ANYTHING if schema is None else nullable(schemas.read(schema.response)),
            query=STRICTNESS,
        )
        return PathItem(f"The service {self.name}", writes={"POST": call}, has_shape=type is not None)

    async def state(self) -> State:
        service, space = self.require(), self.space
        # The graph is read late, so that cached states do not retain a graph.
        return self.states.get_or_make(
            self.url, IdentityKey(service), lambda: State(lambda: service_document(service, space, self.session.graph))
        )

    async def post(self, exchange: Exchange) -> Answer:
        """Call the service with the request in the body: 201 with the call, including its response (paper, Table 2).

        A repetition with the same `Idempotency-Key` returns the first outcome.
        """
        schema = await self.schema()
        request = await self.read_message(exchange, self.url, schema)
        outcome = await self.call(exchange, schema, request)
        problem = call_problem(self.space, outcome)
        if problem is not None:
            raise problem
        resource = CallResource(self.services, outcome.call.id)
        return CreatedAnswer(resource.url, resource, resource.response_state_of(outcome.call))

    async def call(self, exchange: Exchange, schema: ServiceSchema, request: Message) -> CallOutcome:
        """Call the service, once per Idempotency-Key. Raises a 422 Problem for a key of another request."""
        deadline = loop_time() + self.session.settings.call_deadline
        sender, once = sender_of(exchange), await idempotency_key(exchange)
        return await self.session.calls.call(self.name, schema, request, deadline=deadline, sender=sender, once=once)


class CallResource(KeptResource[Call]):
    """One call of a service."""

    kind = shape = "Call"
    url_of = Space.call
    store_of = attrgetter("session.calls")
    title_of = attrgetter("service")
    writes: ClassVar[frozenset[str]] = frozenset({"DELETE"})
    item = PathItem("A call of a service", plain=_CALL, writes={"DELETE": WriteMethod(done=(204,))})

    async def state(self) -> State:
        call = self.require()
        return self.states.get_or_make(self.url, IdentityKey(call), lambda: self.state_of(call))

    def state_of(self, call: Call) -> State:
        """Return the state of this version of the call."""
        return self._state(call, self._plain)

    def response_state_of(self, call: Call) -> State:
        """Return the state with only the response as plain JSON, for the caller."""
        return self._state(call, self._response_json, "response")

    def _state(self, call: Call, plain: Callable[[Call], bytes], part: str = "") -> State:
        has_ended = call.state not in (CallState.RUNNING, CallState.UNKNOWN)
        kind = EndedState if has_ended else State
        shapes = self.space.shapes_of(call.schema)
        return kind(lambda: self.document(call), lambda: plain(call), shapes=shapes, part=part)

    def _response_json(self, call: Call) -> bytes:
        if call.response is None:
            return b"null"
        return lifter(call.schema.response, self.session.lifting).json(call.response, self.url)

    def _plain(self, call: Call) -> bytes:
        """Return the call as plain JSON, with its messages in ROS form."""
        ended_ns = None if call.state is CallState.UNKNOWN else call.answered_ns
        described = {
            "id": call.id,
            "url": self.url,
            "offer": offer_url(self.url),
            "service": call.service,
            "sentBy": None if call.sender is None else call.sender.agent,
            "ended": None if ended_ns is None else date_time(0, ended_ns),
            "state": call.state.value,
            "words": call.words,
        }
        request = lifter(call.schema.request, self.session.lifting).json(call.request, self.url)
        rest = b',"request":' + request + b',"response":' + self._response_json(call) + b"}"
        return orjson.dumps(described)[:-1] + rest

    def document(self, call: Call) -> Document:
        """Return the RDF of this version of the call."""
        return call_document(_view(call), self.space, self.session.lifting)

    async def forms(self) -> Sequence[Form]:
        return (DeleteForm("Forget the call", "Forget"),) if "DELETE" in self.methods() else ()

    async def delete(self, exchange: Exchange) -> Answer:
        """Forget the call, and discard the response of a running one. Raises a 404 Problem if there is no such call."""
        self.require()
        self.session.calls.delete(self.id)
        return Response(status_code=204)


def _view(call: Call) -> CallView:
    schema = call.schema
    return CallView(
        call.id,
        call.service,
        call.state.value,
        call.created_ns,
        call.answered_ns,
        call.words,
        (schema.request, call.request),
        None if call.response is None else (schema.response, call.response),
        None if call.sender is None else call.sender.receipt,
    )


def sender_of(exchange: Exchange) -> Sender:
    """Return the sender of a request: its agent and its receipt."""
    return Sender(exchange.agent.name, exchange.audit.receipt_id())


async def idempotency_key(exchange: Exchange) -> tuple[str, bytes] | None:
    """Return the key of a request that takes effect once, and its body."""
    key = exchange.header("idempotency-key")
    return None if key is None else (key, await exchange.body())


def call_problem(space: Space, outcome: CallOutcome) -> Problem | None:
    """Return the Problem of a failed call, with the URL of the call; None if it has a response."""
    error = outcome.error
    if error is None:
        return None
    url = space.call(outcome.call.id)
    problem = problem_of(error)
    problem.about += (space.service(outcome.call.service),)
    problem.extra |= {"call": url, "state": outcome.call.state.value}
    if isinstance(error, Refused) and not error.words:
        problem.detail = f"{outcome.call.service} refused the call: {error.sentence}"
    elif problem.status == 503 and error.sent is not Sent.NO:
        problem.detail += " It may have been carried out."
    problem.headers["Location"] = url
    return problem


def refusal_problem(space: Space, outcome: CallOutcome) -> Problem | None:
    """Return the Problem of a call whose response has `bool success` false, with the robot's message."""
    call = outcome.call
    if call.response is None:
        return None
    words = refusal_text(call.schema.response, call.response)
    if words is None:
        return None
    problem = problem_of(Refused(f"{call.service} refused", words=words or None, sent=Sent.YES))
    problem.about += (space.service(call.service),)
    problem.extra |= {"call": space.call(call.id)}
    return problem
