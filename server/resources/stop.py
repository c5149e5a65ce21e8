"""`/stop`: POST stops the robot, DELETE releases the stop, GET returns the state."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import orjson
from starlette.responses import Response

from rosld.adapters.base import Watch
from rosld.ontology.body import parse_json
from rosld.ontology.describe_holds import CONFIRM, StepView, StopView, stop_document
from rosld.ontology.document import Document
from rosld.ontology.triples import date_time_literal
from rosld.ontology.vocab import ros
from rosld.server.auth.permissions import ALLOW_ALL, Permissions
from rosld.server.auth.rules import ANONYMOUS
from rosld.server.html.forms import DeleteForm, Form
from rosld.server.http.problem import Problem
from rosld.server.http.token_redaction import redact_tokens
from rosld.server.hypermedia.json_schema import BOOLEAN, TEXT, JsonSchema, MessageSchemas, json_array, nullable
from rosld.server.resources.base import Services, SessionResource
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import JSON
from rosld.server.rest.path_item import PathItem, QueryParameter, WriteMethod
from rosld.server.rest.resource import READ, Answer, ShownAnswer
from rosld.server.rest.state import State

_MAX_REASON = 500
"""Maximum number of characters of a reason."""
_ABOUT = (
    "It publishes zero on velocity topics, ends every hold, cancels goals, runs the stop actions of "
    "mappings, and refuses all writes but zero."
)


_CONFIRM = QueryParameter("confirm", CONFIRM)


class StopResource(SessionResource):
    """The stop of the whole robot."""

    kind = shape = title = "Stop"
    path = "stop"
    links_offer = True
    accepts: Mapping[str, Sequence[str]] = {"POST": (JSON,)}
    passes_unknown_parameters = frozenset({"POST"})  # a typing error must not prevent a stop

    def __init__(self, services: Services) -> None:
        super().__init__(services)
        self.software_stop = services.software_stop

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        count: JsonSchema = {"type": "integer", "minimum": 0}
        words: JsonSchema = {"does": TEXT, "state": TEXT, "subscribers": nullable(count), "words": nullable(TEXT)}
        step: JsonSchema = {"type": "object", "properties": words}
        who: JsonSchema = dict.fromkeys(("by", "since", "reason", "warning"), nullable(TEXT))
        members: JsonSchema = {"stopped": BOOLEAN, **who, "steps": json_array(step)}
        plain: JsonSchema = {"type": "object", "properties": members}
        reason: JsonSchema = {"type": "string", "maxLength": 500}
        stop = WriteMethod(
            "Publishes zero on velocity topics, ends holds, cancels goals, runs the stop actions of mappings, "
            "refuses writes (423).",
            {"type": "object", "properties": {"reason": reason}, "additionalProperties": False},
            "At once, and lasts until a person releases it.",
            is_body_required=False,
            done=(200, 204),
            shows=plain,
        )
        release = WriteMethod("Lets writes reach the robot again.", done=(204,), query=(_CONFIRM,))
        return PathItem("The stop of the whole robot", plain=plain, writes={"POST": stop, "DELETE": release})

    def methods(self) -> frozenset[str]:
        return READ | {"POST", "DELETE"} if self.software_stop.unusable_reason is None else READ

    def deny_reason(self, method: str) -> str:
        if method in ("POST", "DELETE"):
            return self.software_stop.unusable_reason or super().deny_reason(method)
        return f"POST stops the robot, DELETE releases it; {method} is not supported."

    async def state(self) -> State:
        return self.current_state()

    def current_state(self) -> State:
        """Return the current state."""
        version = (
            self.software_stop.revision,
            self.software_stop.steps,
            self.software_stop.stop_state,
            self.software_stop.warning,
        )
        return self.states.get_or_make(self.url, version, lambda: State(self.document, self._plain))

    async def watch(self, wake: Callable[[], None]) -> Watch:
        return self.software_stop.changes.watch(wake)

    def document(self) -> Document:
        """Return the RDF of the stop."""
        stops = self.software_stop
        stop_state = stops.stop_state
        view = StopView(
            [
                StepView(step.description, ros.terms[step.status.value], step.words, step.affects, step.subscribers)
                for step in stops.steps
            ],
            by=None if stop_state is None else stop_state.stopped_by,
            since_ns=None if stop_state is None else stop_state.since_ns,
            reason=None if stop_state is None else stop_state.reason,
            warning=stops.warning,
            is_usable=stops.unusable_reason is None,
        )
        return stop_document(view, self.space)

    def _plain(self) -> bytes:
        return self._plain_for(ALLOW_ALL)

    def _plain_for(self, permissions: Permissions) -> bytes:
        """Return the stop as JSON, with the steps that the agent may see."""
        stops = self.software_stop
        stop_state = stops.stop_state
        since = None if stop_state is None else date_time_literal(stop_state.since_ns)
        steps = [
            {"does": step.description, "state": step.status.value, "subscribers": step.subscribers, "words": step.words}
            for step in stops.steps
            if all(map(permissions.may_read, step.affects))
        ]
        return orjson.dumps(
            {
                "stopped": stop_state is not None,
                "by": None if stop_state is None else stop_state.stopped_by,
                "since": None if since is None else since.value,
                "reason": None if stop_state is None else stop_state.reason,
                "warning": stops.warning,
                "steps": steps,
            }
        )

    def redact(self, state: State, permissions: Permissions) -> State:
        return state.redact(permissions, plain=lambda: self._plain_for(permissions))

    async def forms(self) -> Sequence[Form]:
        if self.software_stop.unusable_reason is not None:
            return ()
        stop = DeleteForm("Stop the robot", "Stop", _ABOUT, method="POST")
        stop_state = self.software_stop.stop_state
        if stop_state is None:
            return (stop,)
        about = f"Writes reach the robot again. This does not restart anything. The id of this stop is {stop_state.id}."
        return (DeleteForm("Release the robot", "Release", about, query=(("confirm", stop_state.id),)), stop)

    async def post(self, exchange: Exchange) -> Answer:
        """Stop the robot: 200 with the steps taken. The body may state a reason."""
        self._require_usable()
        reason = _reason(await exchange.raw_body())  # an unknown charset must not prevent a stop
        exchange.audit.add_step("stop the robot", self.url)
        await self.software_stop.stop(exchange.agent, reason)
        return ShownAnswer(self, self.current_state())

    async def delete(self, exchange: Exchange) -> Answer:
        """Release the stop, which allows writes again.

        Raises a 409 Problem while the robot is still being stopped and for the id of another stop, and a 428 Problem
        for an anonymous request without confirmation.
        """
        self._require_usable()
        self._require_confirmed(exchange)
        if self.software_stop.is_running:
            raise _still_being_stopped()
        exchange.audit.add_step("let writes pass again", self.url)
        if not await self.software_stop.release(exchange.agent):
            raise _still_being_stopped()
        return Response(status_code=204)

    def _require_confirmed(self, exchange: Exchange) -> None:
        """Raise a 428 or 409 Problem unless a person releases the current stop.

        Agents authenticated by --auth need no confirmation; anonymous ones send the id shown on the page of the stop.
        """
        stop_state, confirmed = self.software_stop.stop_state, exchange.query.get("confirm")
        if stop_state is None or confirmed == stop_state.id:
            return
        if confirmed is not None:
            raise Problem(409, f"{confirmed[:40]!r} is not the id of this stop: the page {self.url} shows it.")
        if exchange.agent == ANONYMOUS:
            raise Problem(
                428, f"A person must release the stop: the page {self.url} has the button, and the id to confirm."
            )

    def _require_usable(self) -> None:
        """Raise a 403 Problem if the robot cannot be stopped and released by this server."""
        if (reason := self.software_stop.unusable_reason) is not None:
            raise Problem(403, reason)


def _still_being_stopped() -> Problem:
    sentence = "The robot is still being stopped; release it when that is done."
    return Problem(409, sentence, headers={"Retry-After": "1"})


def _reason(body: bytes) -> str | None:
    """Return the reason in a body, or None for an empty body. Raises a 422 Problem for an invalid body."""
    if not body.strip():
        return None
    match parse_json(body):
        case {"reason": str(reason), **others} if not others and len(reason) <= _MAX_REASON:
            return redact_tokens(" ".join(reason.split())) or None
        case {**others} if not others:
            return None
    raise Problem(422, f'The body is empty, or {{"reason": "..."}} with at most {_MAX_REASON} characters.')
