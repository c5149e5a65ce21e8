"""Services, and the calls made of them: POST calls, the call is a resource."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from starlette.responses import Response

from rosld.adapters.model import Kind, Message, Operation, Ref, Refused, RosError, Sent, Service, ServiceSchema
from rosld.ontology.body import parse_body
from rosld.ontology.describe_services import CallView, call_document, service_document
from rosld.ontology.document import Document
from rosld.ontology.lift import lifter
from rosld.ontology.lower import find_message, lowerer, parse_json
from rosld.server.calls import Call, Gone, KeyReused, Outcome
from rosld.server.errors import problem_of
from rosld.server.html import DeleteForm, Form, MessageForm
from rosld.server.http.problem import Problem
from rosld.server.ldp.exchange import Exchange
from rosld.server.ldp.resource import JSON, RDF_BODIES, READ, Answer, Created, Resource
from rosld.server.ldp.state import State
from rosld.server.resources.namespaces import moved_to_namespace
from rosld.server.robot import Robot, Same


class ServiceResource(Resource):
    """One service."""

    kind = "Service"
    accepts: Mapping[str, Sequence[str]] = {"POST": (*RDF_BODIES, JSON)}

    def __init__(self, robot: Robot, name: str) -> None:
        super().__init__(robot.space.service(name))
        self.title = name
        self.robot = robot
        self.name = name

    @property
    def service(self) -> Service:
        """The service in the computation graph; a 404 Problem where there is none."""
        found = self.robot.graph.services.get(self.name)
        if found is None:
            missing = Problem(404, f"There is no service {self.name}.")
            raise moved_to_namespace(self.robot, "services", self.name) or missing
        return found

    def methods(self) -> frozenset[str]:
        allowed = Operation.CALL in self.robot.adapter.allows(Ref(Kind.SERVICE, self.name))
        return READ | {"POST"} if allowed and not self.robot.settings.read_only else READ

    def why_not(self, method: str) -> str:
        if self.robot.settings.read_only:
            return "This server is read-only."
        if method == "POST":
            return self.service.uncallable or f"{self.name} cannot be called."
        return f"A service is called with POST; it does not answer {method}."

    async def state(self) -> State:
        service = self.service
        space = self.robot.space
        return self.robot.states.get(
            self.url, Same(service), lambda: State(lambda: service_document(service, space, self.robot.graph))
        )

    @property
    def constrained_by(self) -> str | None:
        found = self.robot.graph.services.get(self.name)
        return None if found is None or found.type is None else self.robot.space.shape(f"{found.type.name}_Request")

    async def forms(self) -> Sequence[Form]:
        if "POST" not in self.methods():
            return ()
        try:
            request = (await self._schema()).request
            return (MessageForm(request, "POST", "Call the service", "Call"),)
        except RosError:
            return ()

    async def post(self, exchange: Exchange) -> Answer:
        schema = await self._schema()
        data = await exchange.body()
        request = self._lower(exchange, schema, data)
        deadline = self.robot.deadline(self.robot.settings.call_deadline)
        key = exchange.header("idempotency-key")
        try:
            if key is None:
                outcome = await self.robot.calls.make(self.name, schema, request, deadline=deadline)
            else:
                calls = self.robot.calls
                outcome = await calls.once(key, self.name, schema, request, data, deadline=deadline)
        except KeyReused as error:
            raise Problem(422, f"The Idempotency-Key {key!r} came before with another request.") from error
        return self._told(outcome)

    def _lower(self, exchange: Exchange, schema: ServiceSchema, data: bytes) -> Message:
        """The request in a body; an empty one where the request has no fields."""
        lowering = lowerer(schema.request, self.robot.lifting)
        if not data.strip():
            return lowering.from_json({}, defaults=exchange.flag("defaults"))
        if exchange.media_type == JSON:
            return lowering.from_json(parse_json(data), defaults=exchange.flag("defaults"))
        body = parse_body(data, exchange.media_type, self.url)
        root = find_message(body, self.url, self.robot.space.class_of(schema.request.ref.name), "#request")
        return lowering.from_graph(body, root, self.url)

    async def _schema(self) -> ServiceSchema:
        service = self.service
        if service.type is None:
            raise Problem(409, f"{self.name} cannot be called: {service.uncallable or 'its type is not known'}.")
        return await self.robot.schemas.service(service.type)

    def _told(self, outcome: Outcome) -> Answer:
        """201 with the call as body; where it did not succeed the error's status, with the call's URL."""
        url = self.robot.space.call(outcome.call.id)
        error = outcome.error
        if error is None:
            resource = CallResource(self.robot, outcome.call.id)
            return Created(url, resource, resource.shown(outcome.call))
        problem = problem_of(error)
        problem.extra |= {"call": url, "state": outcome.call.state.value}
        if isinstance(error, Refused):
            problem.detail = f"{self.name} refused the call: {error.words or error.sentence}"
        elif problem.status == 503 and error.sent is not Sent.NO:
            problem.detail += " It may have been carried out."
        problem.headers["Location"] = url
        raise problem


class CallResource(Resource):
    """One call of a service."""

    kind = "Call"

    def __init__(self, robot: Robot, id: str) -> None:
        super().__init__(robot.space.call(id))
        self.title = id
        self.robot = robot
        self.id = id

    def methods(self) -> frozenset[str]:
        return READ if self.robot.settings.read_only else READ | {"DELETE"}

    @property
    def call(self) -> Call:
        """The call; a 404 or 410 Problem where it is not kept."""
        try:
            return self.robot.calls.find(self.id)
        except Gone as error:
            raise Problem(410, f"The call {self.id} was deleted or has become too old.") from error
        except KeyError as error:
            raise Problem(404, f"There is no call {self.id}.") from error

    async def state(self) -> State:
        call = self.call
        return self.robot.states.get(self.url, Same(call), lambda: self.shown(call))

    def shown(self, call: Call) -> State:
        """The state of this call as it stood."""

        def plain() -> bytes:
            if call.response is None:
                return b"null"
            return lifter(call.schema.response, self.robot.lifting).json(call.response, self.url)

        return State(lambda: self.document(call), plain)

    def document(self, call: Call) -> Document:
        """The RDF of this call as it stood."""
        return call_document(_view(call), self.robot.space, self.robot.lifting)

    async def forms(self) -> Sequence[Form]:
        return (DeleteForm("Forget the call", "Forget"),) if "DELETE" in self.methods() else ()

    async def delete(self, exchange: Exchange) -> Answer:
        _ = self.call
        self.robot.calls.delete(self.id)
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
    )
