"""Services, and the calls made of them: POST calls, the call is a resource."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import orjson
from starlette.responses import Response

from rosld.adapters.base import Watch
from rosld.adapters.model import Kind, Operation, Ref, RosError, Service, ServiceSchema, UnknownType
from rosld.ontology.describe_services import CallView, call_document, service_document
from rosld.ontology.document import Document
from rosld.ontology.lift import lifter
from rosld.ontology.literals import date_time
from rosld.server.html.forms import DeleteForm, Form, MessageForm
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import ANYTHING, TEXT, URI, JsonSchema, MessageSchemas, nullable
from rosld.server.resources.accepted_shape import CommandResource, message_shape, shape_query
from rosld.server.resources.limit_checks import STRICTNESS, LimitChecks
from rosld.server.resources.namespaces import is_absent, redirect_to_namespace
from rosld.server.resources.service_request import call_problem, call_service, read_request
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import JSON, RDF_BODIES
from rosld.server.rest.path_item import PathItem, WriteMethod
from rosld.server.rest.resource import READ, Answer, CreatedAnswer, Resource
from rosld.server.rest.state import EndedState, State
from rosld.server.robot.calls import Call, CallState, Gone
from rosld.server.robot.session import Session
from rosld.server.robot.write_policy import resources_only_reason
from rosld.server.runtime.version_cache import IdentityKey, VersionCache

_CALL: JsonSchema = {
    "type": "object",
    "properties": {
        **dict.fromkeys(("id", "service", "state"), TEXT),
        **{name: nullable(TEXT) for name in ("sentBy", "ended", "words")},
        "url": URI,
    },
}


class ServiceResource(CommandResource):
    """One service."""

    kind = "Service"
    shape = "Service"
    accepts: Mapping[str, Sequence[str]] = {"POST": (*RDF_BODIES, JSON)}

    def __init__(self, session: Session, limit_checks: LimitChecks, states: VersionCache[State], name: str) -> None:
        super().__init__(session.space, session.space.service(name))
        self.title = name
        self.session = session
        self.limit_checks = limit_checks
        self.states = states
        self.name = name

    @property
    def service(self) -> Service:
        """The service in the computation graph; a 404 Problem where there is none."""
        graph = self.session.graph
        found = graph.services.get(self.name)
        if found is None:
            missing = Problem(404, f"There is no service {self.name}.")
            raise redirect_to_namespace(self.space, graph, "services", self.name) or missing
        return found

    @property
    def is_absent(self) -> bool:
        return is_absent(self.space, self.session.graph, "services", self.name)

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        type = self.service.type
        schema = schemas.service(type)
        call = WriteMethod(
            "Calls the service; the call is a resource, and `Idempotency-Key` makes it once only.",
            schemas.write(schema.request if schema else None),
            is_body_required=False,
            done=(201,),
            shows=ANYTHING if schema is None else nullable(schemas.read(schema.response)),
            query=STRICTNESS,
        )
        return PathItem(f"The service {self.name}", writes={"POST": call}, has_shape=type is not None)

    def methods(self) -> frozenset[str]:
        if self.session.settings.read_only or self.session.is_resources_only(self.name):
            return READ
        allowed = Operation.CALL in self.session.adapter.allows(Ref(Kind.SERVICE, self.name))
        return READ | {"POST"} if allowed else READ

    def deny_reason(self, method: str) -> str:
        if self.session.settings.read_only:
            return "This server is read-only."
        if method == "POST" and self.session.is_resources_only(self.name):
            return resources_only_reason(self.name)
        if method == "POST":
            return self.service.uncallable or f"{self.name} cannot be called."
        return f"A service is called with POST; it does not answer {method}."

    async def state(self) -> State:
        service, space = self.service, self.space
        # The graph is read when the document is made: a state is cached, and would keep a whole graph in memory.
        return self.states.get_or_make(
            self.url, IdentityKey(service), lambda: State(lambda: service_document(service, space, self.session.graph))
        )

    @property
    def constrained_by(self) -> str | None:
        found = self.session.graph.services.get(self.name)
        return None if found is None or found.type is None else shape_query(self.url)

    async def accepted(self, url: str) -> Document | None:
        request = (await self._schema()).request
        return await message_shape(self.space, self.limit_checks, Kind.SERVICE, self.name, request, url, "#request")

    async def forms(self) -> Sequence[Form]:
        if "POST" not in self.methods():
            return ()
        try:
            request = (await self._schema()).request
            return (MessageForm(request, "POST", "Call the service", "Call"),)
        except (Problem, RosError):
            return ()

    async def post(self, exchange: Exchange) -> Answer:
        """Call the service with the request in the body: 201 with the call, which has the response (paper, Table 2).

        A repetition with the same `Idempotency-Key` gets the first outcome.
        """
        schema = await self._schema()
        request = await read_request(
            exchange, self.space, self.session.lifting, self.limit_checks, self.name, schema, self.url
        )
        await self.limit_checks.require_message(Kind.SERVICE, self.name, schema.request, request, self.url, "#request")
        outcome = await call_service(exchange, self.session, self.name, schema, request)
        problem = call_problem(self.space, outcome)
        if problem is not None:
            raise problem
        resource = CallResource(self.session, self.states, outcome.call.id)
        return CreatedAnswer(resource.url, resource, resource.response_state_of(outcome.call))

    async def _schema(self) -> ServiceSchema:
        service = self.service
        if service.type is None:
            raise Problem(409, f"{self.name} cannot be called: {service.uncallable or 'its type is not known'}.")
        try:
            return await self.session.schemas.service(service.type)
        except UnknownType as error:
            raise Problem(409, f"{self.name} cannot be called: {error.sentence}") from error


class CallResource(Resource):
    """One call of a service."""

    kind = "Call"
    shape = "Call"

    def __init__(self, session: Session, states: VersionCache[State], id: str) -> None:
        super().__init__(session.space, session.space.call(id))
        try:
            self.title = session.calls.find(id).service
        except LookupError:
            self.title = id
        self.session = session
        self.states = states
        self.id = id

    @property
    def is_absent(self) -> bool:
        try:
            _ = self.call
        except Problem:
            return True
        return False

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem("A call of a service", plain=_CALL, writes={"DELETE": WriteMethod(done=(204,))})

    def methods(self) -> frozenset[str]:
        return READ if self.session.settings.read_only else READ | {"DELETE"}

    @property
    def call(self) -> Call:
        """The call; a 404 or 410 Problem where it is not kept."""
        try:
            return self.session.calls.find(self.id)
        except Gone as error:
            raise Problem(410, f"The call {self.id} was deleted or has become too old.") from error
        except KeyError as error:
            raise Problem(404, f"There is no call {self.id}.") from error

    async def state(self) -> State:
        call = self.call
        return self.states.get_or_make(self.url, IdentityKey(call), lambda: self.state_of(call))

    async def watch(self, wake: Callable[[], None]) -> Watch:
        return self.session.calls.changes.watch(wake)

    def state_of(self, call: Call) -> State:
        """Return the state of this call as it stood."""
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
        """How it stands as JSON, its messages as ROS's own."""
        ended_ns = None if call.state is CallState.UNKNOWN else call.answered_ns
        described = {
            "id": call.id,
            "url": self.url,
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
        """Return the RDF of this call as it stood."""
        return call_document(_view(call), self.space, self.session.lifting)

    async def forms(self) -> Sequence[Form]:
        return (DeleteForm("Forget the call", "Forget"),) if "DELETE" in self.methods() else ()

    async def delete(self, exchange: Exchange) -> Answer:
        """Forget the call; of one that is still running the answer is dropped.

        Raises a 404 Problem where there is none.
        """
        _ = self.call
        self.session.calls.delete(self.id)
        return Response(status_code=204)


def _view(call: Call) -> CallView:
    """A call as it is described."""
    schema = call.schema
    return CallView(
        call.id,
        call.service,
        call.state.value,
        call.created_ns,
        (schema.request, call.request),
        None if call.response is None else (schema.response, call.response),
        call.answered_ns,
        call.words,
        None if call.sender is None else call.sender.receipt,
    )
