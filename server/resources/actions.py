"""Actions and their goals: POST creates a goal as a resource, DELETE cancels it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Sequence
from operator import attrgetter

import orjson
from starlette.responses import Response

from rosld.adapters.base import Watch
from rosld.adapters.model import (
    Action,
    ActionSchema,
    GoalStatus,
    Kind,
    Message,
    MessageSchema,
    NotFound,
    Operation,
    Refused,
    RosError,
    Sent,
    TypeRef,
)
from rosld.ontology.describe_services import GoalView, action_document, goal_document
from rosld.ontology.document import Document, Envelope
from rosld.ontology.lift import lifter
from rosld.ontology.literals import date_time
from rosld.ontology.urls import Space
from rosld.server.html.forms import DeleteForm, Form
from rosld.server.http.fields import to_uri
from rosld.server.http.problem import READ_ONLY, Problem
from rosld.server.hypermedia.json_schema import TEXT, URI, JsonSchema, MessageSchemas, json_object, nullable
from rosld.server.resources.limit_checks import STRICTNESS
from rosld.server.resources.named_resource import KeptResource
from rosld.server.resources.services import InvocableResource, idempotency_key, sender_of
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import PathItem, WriteMethod
from rosld.server.rest.resource import READ, Answer, CreatedAnswer
from rosld.server.rest.responses import offer_url
from rosld.server.rest.ros_problems import problem_of
from rosld.server.rest.state import EndedState, State
from rosld.server.robot.goal_store import Goal
from rosld.server.robot.goals import GoalSubmission
from rosld.server.robot.session import Session
from rosld.server.robot.write_policy import resources_only_reason
from rosld.server.runtime.dry_run import DryRunEnded, expect_status
from rosld.server.runtime.tasks import loop_time
from rosld.server.runtime.version_cache import IdentityKey

GOAL_ENDS = (
    "201 with the goal's URL (Location). Wait there by ?until=status = 'succeeded'&timeout=60: 409 if it ended "
    "otherwise. DELETE cancels."
)


class ActionResource(InvocableResource[Action, ActionSchema]):
    """One action."""

    kind = shape = "Action"
    ros_kind = Kind.ACTION
    url_of = Space.action
    operation = Operation.SEND_GOAL
    usage = "Goals are sent to an action"
    cannot = "No goal can be sent to {}"
    form = ("Send a goal", "Send")

    def find_schema(self, type: TypeRef) -> Awaitable[ActionSchema]:
        return self.session.schemas.action(type)

    def part(self, schema: ActionSchema) -> MessageSchema:
        return schema.goal

    def unusable(self, found: Action) -> str | None:
        return found.unusable

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        type = self.require().type
        schema = schemas.find(type, ActionSchema)
        send = WriteMethod(
            "Sends a goal, once per `Idempotency-Key`.",
            schemas.write(schema.goal if schema else None),
            GOAL_ENDS,
            is_body_required=False,
            done=(201,),
            shows=_goal_schema(schemas, schema),
            query=STRICTNESS,
        )
        return PathItem(f"The action {self.name}", writes={"POST": send}, has_shape=type is not None)

    @property
    def takes_goals(self) -> bool:
        """Whether a goal can be sent here now."""
        return "POST" in self.methods() - self.withheld

    async def state(self) -> State:
        graph = self.session.graph
        action = self.require(graph)
        await follow_action(self.session, self.name)
        goals = tuple(goal.id for goal in self.session.goals.of_action(self.name))
        version = (IdentityKey(action), goals, self.takes_goals, graph.revision)
        return self.states.get_or_make(self.url, version, lambda: State(self.document))

    def document(self) -> Document:
        """Return the current RDF of the action. Created on demand, so that cached states do not retain a graph."""
        graph = self.session.graph
        goals = [goal.id for goal in self.session.goals.of_action(self.name)]
        action = self.require(graph)
        return action_document(action, self.space, graph, goals, takes_goals=self.takes_goals)

    async def watch(self, wake: Callable[[], None]) -> Watch:
        await follow_action(self.session, self.name)
        return self.session.goals.watch(self.name, wake)

    async def post(self, exchange: Exchange) -> Answer:
        """Send the goal in the body: 201 once it is accepted, with the goal (paper, Table 2)."""
        schema = await self.schema()
        return await self.send(exchange, schema, await self.read_message(exchange, self.url, schema))

    async def send(self, exchange: Exchange, schema: ActionSchema, message: Message) -> CreatedAnswer:
        """Send a goal: 201 once it is accepted. Raises RosError and Problems if it is not."""
        deadline, once = loop_time() + self.session.settings.call_deadline, await idempotency_key(exchange)
        sending = await self.session.goals.send(
            self.name, schema, message, deadline=deadline, sender=sender_of(exchange), once=once
        )
        problem = _failure(self.space, self.name, sending)
        if problem is not None or sending.goal is None:
            raise problem or Problem(502, f"{self.name} did not accept the goal.")
        resource = GoalResource(self.services, sending.goal.id)
        return CreatedAnswer(resource.url, resource, resource.state_of(sending.goal))

    async def cancel_goals(self, *, others: bool = False) -> Response:
        """Cancel the active goals sent by this server and, with `others`, those of other clients.

        The answer names the newest one. Raises a 409 Problem if there are none, or if one is not canceled.
        """
        await follow_action(self.session, self.name)
        pursued = [goal for goal in self.session.goals.of_action(self.name) if goal.is_cancelable]
        cancelable = [goal for goal in pursued if goal.is_own or others]
        if not cancelable:
            hint = " Other clients have sent goals: cancel them with ?others=true." if pursued else ""
            raise Problem(409, f"{self.name} has no active goal that was sent through rosld.{hint}")
        answer = Response(status_code=202)
        for goal in cancelable:
            with contextlib.suppress(DryRunEnded):
                answer = await _cancel(self.session, goal)
        return answer


class GoalResource(KeptResource[Goal]):
    """One goal of an action."""

    kind = shape = "Goal"
    url_of = Space.goal
    store_of = attrgetter("session.goals")
    title_of = attrgetter("action")

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        cancel = WriteMethod("Cancels an active goal (202), forgets an ended one (204).", done=(202, 204))
        return PathItem(
            "A goal of an action",
            plain=_goal_schema(schemas, None),
            writes={"DELETE": cancel},
            methods=READ if self.session.settings.read_only else READ | {"DELETE"},
        )

    def methods(self) -> frozenset[str]:
        try:
            goal: Goal = self.store.find(self.id)
        except LookupError:
            return READ
        return READ | {"DELETE"} if self._is_open(goal) and goal.status is not GoalStatus.CANCELING else READ

    def deny_reason(self, method: str) -> str:
        if self.session.settings.read_only:
            return READ_ONLY
        goal = self.require()
        if method != "DELETE":
            return f"A goal is canceled with DELETE; it does not support {method}."
        if goal.status is GoalStatus.CANCELING:
            return f"The goal {self.id} is being canceled; it can be forgotten once it has ended."
        return resources_only_reason(goal.action)

    def _is_open(self, goal: Goal) -> bool:
        """Whether the goal may be canceled or forgotten; ended goals always, unless read-only."""
        is_closed = not goal.status.is_final and self.session.is_resources_only(goal.action)
        return not (self.session.settings.read_only or is_closed)

    async def state(self) -> State:
        goal = self.require()
        if not goal.is_own and not goal.status.is_final:
            await follow_action(self.session, goal.action)
        return self.state_of(self.require())

    async def watch(self, wake: Callable[[], None]) -> Watch:
        goal = self.require()
        if not goal.is_own and not goal.status.is_final:
            await follow_action(self.session, goal.action)
        return self.session.goals.watch(goal.action, wake, self.id)

    def state_of(self, goal: Goal) -> State:
        """Return the state of this version of the goal."""
        return self.states.get_or_make(
            self.url, (IdentityKey(goal), self._is_open(goal)), lambda: self._make_state(goal)
        )

    def _make_state(self, goal: Goal) -> State:
        shapes = () if goal.schema is None else self.space.shapes_of(goal.schema)
        state = State(lambda: self.document(goal), lambda: self._plain(goal), shapes=shapes)
        if not goal.status.is_settled:
            return state
        has_result = goal.result is not None or goal.key is None  # the result may arrive after the status
        open_members = frozenset[str]() if has_result else frozenset({"result"})
        return EndedState(state.describe, state.plain, shapes=shapes, open_members=open_members)

    def document(self, goal: Goal) -> Document:
        """Return the RDF of this version of the goal."""
        return goal_document(
            _view(goal, cancelable=goal.is_cancelable and self._is_open(goal)), self.space, self.session.lifting
        )

    def _plain(self, goal: Goal) -> bytes:
        """Return the goal as plain JSON, with its messages in ROS form."""
        members = {
            "id": self.id,
            "url": self.url,
            "offer": offer_url(self.url),
            "action": goal.action,
            "sentBy": None if goal.sender is None else goal.sender.agent,
            "ended": None if goal.ended_ns is None else date_time(0, goal.ended_ns),
            "status": goal.status.value,
            "words": goal.words,
        }
        schema = goal.schema
        messages = {
            "goal": self._json(schema.goal if schema else None, goal.goal),
            "feedback": self._json(
                schema.feedback if schema else None, goal.feedback.message if goal.feedback else None
            ),
            "result": self._json(schema.result if schema else None, goal.result),
        }
        rest = b",".join(b'"%s":%s' % (name.encode(), data) for name, data in messages.items())
        return orjson.dumps(members)[:-1] + b"," + rest + b"}"

    def _json(self, schema: MessageSchema | None, message: Message | None) -> bytes:
        if schema is None or message is None:
            return b"null"
        return lifter(schema, self.session.lifting).json(message, self.url)

    async def forms(self) -> Sequence[Form]:
        if "DELETE" not in self.methods():
            return ()
        if self.require().status.is_final:
            return (DeleteForm("Forget the goal", "Forget"),)
        return (DeleteForm("Cancel the goal", "Cancel"),)

    async def delete(self, exchange: Exchange) -> Answer:
        """Forget an ended goal (204), or request the cancellation of an active one (202); its state shows the outcome.

        Raises a 409 Problem if the action server refuses to cancel it.
        """
        goal, goals = self.require(), self.session.goals
        if goal.status.is_final:
            goals.delete(self.id)
            return Response(status_code=204)
        return await _cancel(self.session, goal)


async def _cancel(session: Session, goal: Goal) -> Response:
    """Request the cancellation of a goal. Raises a 409 Problem if that is refused, and RosError."""
    expect_status(202)
    try:
        await session.goals.cancel(goal, deadline=loop_time() + session.settings.call_deadline)
    except (Refused, NotFound) as error:
        problem = problem_of(error)
        problem.status = 409
        problem.detail = f"The goal {goal.id} was not canceled: {error.sentence}"
        raise problem from error
    return Response(status_code=202, headers={"Location": to_uri(session.space.goal(goal.id))})


async def follow_action(session: Session, action: str) -> None:
    """Follow the goals of other clients; the first call waits briefly for the current goals."""
    found = session.graph.actions.get(action)
    if found is None or found.type is None:
        return
    try:
        await session.schemas.action(found.type)
        await session.goals.follow(action, deadline=loop_time() + session.settings.first_value_wait)
    except (RosError, asyncio.TimeoutError):
        pass  # goals of others are unreadable now; known goals are still shown


def _goal_schema(schemas: MessageSchemas, schema: ActionSchema | None) -> JsonSchema:
    """Return the JSON schema of a goal's state."""
    parts = {} if schema is None else {"goal": schema.goal, "feedback": schema.feedback, "result": schema.result}
    messages = {name: nullable(schemas.read(part)) for name, part in parts.items()}
    status: JsonSchema = {"type": "string", "enum": [status.value for status in GoalStatus]}
    words: JsonSchema = {
        "id": TEXT, "url": URI, "offer": URI, "action": TEXT, "sentBy": nullable(TEXT), "ended": nullable(TEXT),
        "status": status, "words": nullable(TEXT),
    }  # fmt: skip
    return json_object(optional={**words, **messages})


def _failure(space: Space, action: str, sending: GoalSubmission) -> Problem | None:
    """Return the Problem of a goal that was not accepted, with its URL if it has one; None without an error."""
    error = sending.error
    if error is None:
        return None
    problem = problem_of(error)
    if isinstance(error, Refused):
        problem.status = 409
        if not error.words:
            problem.detail = f"{action} rejected the goal: {error.sentence}"
    elif problem.status == 503 and error.sent is not Sent.NO:
        problem.detail += " It may have been carried out."
    if sending.goal is not None:
        url = space.goal(sending.goal.id)
        problem.extra |= {"goal": url, "status": sending.goal.status.value}
        problem.headers["Location"] = url
    return problem


def _view(goal: Goal, *, cancelable: bool) -> GoalView:
    schema, latest = goal.schema, goal.feedback
    return GoalView(
        goal.id,
        goal.action,
        goal.status,
        goal.created_ns,
        goal.ended_ns,
        goal.words,
        None if goal.key is None else goal.key.id,
        goal.is_own,
        (schema.goal, goal.goal) if schema and goal.goal is not None else None,
        (schema.feedback, latest.message, Envelope(latest.received_ns, latest.count)) if schema and latest else None,
        (schema.result, goal.result) if schema and goal.result is not None else None,
        goal.unreadable,
        cancelable,
        None if goal.sender is None else goal.sender.receipt,
    )
