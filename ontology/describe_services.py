"""Documents of services and actions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from msgspec import Struct
from pyoxigraph import NamedNode

from rosld.adapters.model import Action, GoalStatus, Graph, Message, MessageSchema, Service
from rosld.ontology import kinds
from rosld.ontology.describe_topics import type_url
from rosld.ontology.document import Document, Envelope, LiftedMessage
from rosld.ontology.lift import LiftSettings, lifter
from rosld.ontology.names import is_namespace
from rosld.ontology.node_shape import SOURCE, NodeShape, many, one, optional
from rosld.ontology.triples import BODIES, SSE, STREAM, affordance, forms, statements
from rosld.ontology.urls import Space
from rosld.ontology.vocab import prov, rdfs, ros, td

_SETTINGS = LiftSettings()


_SERVICE = NodeShape[Service]("Service", "a service", ros.Service, *SOURCE, is_listed=True).with_properties(
    one(ros.name, kinds.NAME, lambda service: service.name),
    optional(ros.hasServiceType, kinds.CLASS, lambda service: service.type),
    optional(ros.requestShape, kinds.shape_of("_Request"), lambda service: service.type),
    optional(ros.responseShape, kinds.shape_of("_Response"), lambda service: service.type),
    many(ros.provider, kinds.NODE, lambda service: dict.fromkeys(service.providers)),
    optional(ros.uncallable, kinds.TEXT, lambda service: service.uncallable),
    optional(ros.namespace, kinds.SERVICE),
)


def service_document(service: Service, space: Space, graph: Graph) -> Document:
    """Return a service: its type, providers, the shapes of request and response, and why it cannot be called."""
    url = space.service(service.name)
    namespace = NamedNode(url + "/") if is_namespace(service.name, graph.services) else None
    triples = _SERVICE.triples(NamedNode(url), service, space, (ros.namespace, namespace))
    if service.type is not None:
        triples += type_url(service.type, space)
    return Document(url, tuple(triples), simulated_time=graph.simulated_time)


class CallOutline(Struct, frozen=True):
    """The part of a call that lists include: `state` is a local name of the vocabulary (`Running`, `Succeeded`, ...).

    Times are wall-clock nanoseconds.
    """

    id: str
    service: str
    state: str
    created_ns: int
    answered_ns: int | None
    words: str | None


class CallView(CallOutline, frozen=True, eq=False):
    """A call with all that its document describes; a message comes with its schema.

    `receipt` is the id of the receipt of its request.
    """

    request: tuple[MessageSchema, Message]
    response: tuple[MessageSchema, Message] | None = None
    receipt: str | None = None


CALL_OUTLINE = NodeShape[CallOutline]("Call", "a call of a service", ros.Call).with_properties(
    one(rdfs.label, kinds.TEXT, lambda call: f"Call of {call.service}"),
    one(ros.isCallOf, kinds.SERVICE, lambda call: call.service),
    one(
        ros.state,
        kinds.TERM.where("sh:in ( ros:Running ros:Succeeded ros:Failed ros:Refused ros:OutcomeUnknown ros:NotSent )"),
        lambda call: ros.terms[call.state],
    ),
    one(prov.startedAtTime, kinds.DATE_TIME, lambda call: call.created_ns),
    optional(prov.endedAtTime, kinds.DATE_TIME, lambda call: call.answered_ns),
    optional(ros.words, kinds.TEXT, lambda call: call.words),
)
_CALL = NodeShape[CallView](
    CALL_OUTLINE.name, CALL_OUTLINE.label, ros.Call, *SOURCE, required=(ros.request,)
).with_properties(
    *CALL_OUTLINE.properties,
    optional(ros.request, kinds.MESSAGE, lambda call: "#request"),
    optional(ros.response, kinds.MESSAGE, lambda call: "#response" if call.response else None),
    optional(prov.wasInformedBy, kinds.ACTIVITY, lambda call: call.receipt),
)


def call_document(call: CallView, space: Space, settings: LiftSettings = _SETTINGS) -> Document:
    """Return the document of a call: its request, its response, its outcome."""
    url = space.call(call.id)
    parts = {"#request": call.request, "#response": call.response}
    messages = [LiftedMessage(node, lifter(part[0], settings), part[1]) for node, part in parts.items() if part]
    return Document(url, tuple(_CALL.triples(NamedNode(url), call, space)), tuple(messages))


_ACTION = NodeShape[Action]("Action", "an action", ros.Action, *SOURCE, is_listed=True).with_properties(
    one(ros.name, kinds.NAME, lambda action: action.name),
    optional(ros.hasActionType, kinds.CLASS, lambda action: action.type),
    optional(ros.goalShape, kinds.shape_of("_Goal"), lambda action: action.type),
    optional(ros.resultShape, kinds.shape_of("_Result"), lambda action: action.type),
    optional(ros.feedbackShape, kinds.shape_of("_Feedback"), lambda action: action.type),
    many(ros.provider, kinds.NODE, lambda action: dict.fromkeys(action.servers)),
    many(ros.client, kinds.NODE, lambda action: dict.fromkeys(action.clients)),
    optional(ros.unusable, kinds.TEXT, lambda action: action.unusable),
    optional(ros.namespace, kinds.ACTION),
    many(ros.hasGoal, kinds.GOAL),
    many(td.hasActionAffordance, kinds.ACTION_AFFORDANCE),
)


def action_document(
    action: Action, space: Space, graph: Graph, goals: Sequence[str] = (), *, takes_goals: bool = False
) -> Document:
    """Return the document of an action: its type, its servers and clients, the shapes of its messages, its goals.

    `takes_goals`: goals can be sent here now, and the action gets a form.
    """
    url = space.action(action.name)
    subject = NamedNode(url)
    triples = _ACTION.triples(
        subject,
        action,
        space,
        (ros.namespace, NamedNode(url + "/") if is_namespace(action.name, graph.actions) else None),
        *statements(ros.hasGoal, [NamedNode(space.goal(goal)) for goal in goals]),
    )
    if takes_goals and action.type is not None:
        shape = (ros.goalShape, NamedNode(space.shape(f"{action.type.name}_Goal")))
        triples += affordance(subject, "send", td.hasActionAffordance, td.ActionAffordance, shape)
        triples += forms(NamedNode(f"{url}#send"), "invoke", "POST", td.invokeAction, url, BODIES)
    if action.type is not None:
        triples += type_url(action.type, space)
    return Document(url, tuple(triples), simulated_time=graph.simulated_time)


class GoalOutline(Struct, frozen=True):
    """The part of a goal that lists include. Times are wall-clock nanoseconds."""

    id: str
    action: str
    status: GoalStatus
    created_ns: int | None
    ended_ns: int | None
    words: str | None


class GoalView(GoalOutline, frozen=True, eq=False):
    """A goal with all that its document describes; messages come with their schema, feedback with its time and number.

    `goal_id` is the id that its server uses. `cancelable`: it can be canceled here now, and gets a form. `receipt` is
    the id of the receipt of the request that sent it.
    """

    goal_id: str | None
    own: bool
    goal: tuple[MessageSchema, Message] | None = None
    feedback: tuple[MessageSchema, Message, Envelope] | None = None
    result: tuple[MessageSchema, Message] | None = None
    unreadable: str | None = None
    cancelable: bool = False
    receipt: str | None = None


_STATUS: Mapping[GoalStatus, NamedNode] = {status: ros.terms[status.value.capitalize()] for status in GoalStatus}
GOAL_OUTLINE = NodeShape[GoalOutline]("Goal", "a goal of an action", ros.Goal).with_properties(
    one(rdfs.label, kinds.TEXT, lambda goal: f"Goal of {goal.action}"),
    one(ros.isGoalOf, kinds.ACTION, lambda goal: goal.action),
    one(ros.status, kinds.STATE, lambda goal: _STATUS[goal.status]),
    one(ros.statusWord, kinds.TEXT, lambda goal: goal.status.value),
    optional(ros.words, kinds.TEXT, lambda goal: goal.words),
    one(prov.startedAtTime, kinds.DATE_TIME, lambda goal: goal.created_ns),
    optional(prov.endedAtTime, kinds.DATE_TIME, lambda goal: goal.ended_ns),
)
_GOAL = NodeShape[GoalView](
    GOAL_OUTLINE.name, GOAL_OUTLINE.label, ros.Goal, *SOURCE, required=(ros.own,)
).with_properties(
    *GOAL_OUTLINE.properties,
    optional(ros.goalId, kinds.TEXT, lambda goal: goal.goal_id),
    optional(ros.own, kinds.BOOLEAN, lambda goal: goal.own),
    optional(prov.wasInformedBy, kinds.ACTIVITY, lambda goal: goal.receipt),
    optional(ros.unreadable, kinds.TEXT, lambda goal: goal.unreadable),
    optional(ros.goalMessage, kinds.MESSAGE, lambda goal: "#goal" if goal.goal else None),
    optional(ros.feedback, kinds.MESSAGE, lambda goal: "#feedback" if goal.feedback else None),
    optional(ros.result, kinds.MESSAGE, lambda goal: "#result" if goal.result else None),
    many(td.hasEventAffordance, kinds.EVENT_AFFORDANCE),
    many(td.hasActionAffordance, kinds.ACTION_AFFORDANCE),
)


def goal_document(goal: GoalView, space: Space, settings: LiftSettings = _SETTINGS) -> Document:
    """Return the document of a goal: its message, its status, the latest feedback, the result."""
    url = space.goal(goal.id)
    subject = NamedNode(url)
    parts = {"#goal": goal.goal, "#feedback": goal.feedback, "#result": goal.result}
    messages = [
        LiftedMessage(node, lifter(part[0], settings), part[1], part[2] if len(part) > 2 else None)
        for node, part in parts.items()
        if part
    ]
    triples = _GOAL.triples(subject, goal, space)
    if not goal.status.is_final:
        triples += affordance(subject, "events", td.hasEventAffordance, td.EventAffordance)
        events = NamedNode(f"{url}#events")
        triples += forms(events, "subscribe", "GET", td.subscribeEvent, url, STREAM, SSE)
    if goal.cancelable:
        triples += affordance(subject, "cancel", td.hasActionAffordance, td.ActionAffordance)
        triples += forms(NamedNode(f"{url}#cancel"), "cancel", "DELETE", td.cancelAction, url)
    return Document(url, tuple(triples), tuple(messages))
