"""Documents of services and actions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from msgspec import Struct
from pyoxigraph import NamedNode, Triple

from rosld.adapters.model import Action, GoalStatus, Graph, Message, MessageSchema, Service
from rosld.ontology.describe_topics import type_url
from rosld.ontology.document import Document, Envelope, LiftedMessage
from rosld.ontology.lift import LiftSettings, lifter
from rosld.ontology.names import is_namespace
from rosld.ontology.triples import (
    BODIES,
    RDF_SOURCE,
    SSE,
    STREAM,
    Statement,
    affordance,
    boolean,
    date_time_literal,
    forms,
    statements,
    text,
    triples_about,
)
from rosld.ontology.urls import Space
from rosld.ontology.vocab import prov, rdf, ros, td

_SETTINGS = LiftSettings()


def service_document(service: Service, space: Space, graph: Graph) -> Document:
    """Return a service: its type, providers, the shapes of request and response, and why it cannot be called."""
    url = space.service(service.name)
    triples = triples_about(
        NamedNode(url),
        (rdf.type, ros.Service),
        *RDF_SOURCE,
        (ros.name, text(service.name)),
        *_service_type(service, space),
        *statements(ros.provider, [NamedNode(space.node(node)) for node in dict.fromkeys(service.providers)]),
        (ros.uncallable, text(service.uncallable)),
        (ros.namespace, NamedNode(url + "/") if is_namespace(service.name, graph.services) else None),
    )
    if service.type is not None:
        triples += type_url(service.type, space)
    return Document(url, tuple(triples), simulated_time=graph.simulated_time)


def _service_type(service: Service, space: Space) -> list[Statement]:
    if service.type is None:
        return []
    name = service.type.name
    return [
        (ros.hasServiceType, NamedNode(space.class_of(name))),
        (ros.requestShape, NamedNode(space.shape(f"{name}_Request"))),
        (ros.responseShape, NamedNode(space.shape(f"{name}_Response"))),
    ]


class CallView(Struct, frozen=True, eq=False):
    """A call as it is described: `state` is a local name of the vocabulary (`Running`, `Succeeded`, ...).

    A message comes with its schema. Times are wall-clock nanoseconds. `receipt` is the id of that of its request.
    """

    id: str
    service: str
    state: str
    created_ns: int
    request: tuple[MessageSchema, Message]
    response: tuple[MessageSchema, Message] | None = None
    answered_ns: int | None = None
    words: str | None = None
    receipt: str | None = None


def call_document(call: CallView, space: Space, settings: LiftSettings = _SETTINGS) -> Document:
    """Return the document of a call: its request, its response, its outcome."""
    url = space.call(call.id)
    halves = {"request": call.request, "response": call.response}
    messages = tuple(
        LiftedMessage(f"#{half}", lifter(found[0], settings), found[1]) for half, found in halves.items() if found
    )
    triples = triples_about(
        NamedNode(url),
        *RDF_SOURCE,
        (ros.request, NamedNode(f"{url}#request")),
        (ros.response, NamedNode(f"{url}#response") if call.response else None),
        (prov.wasInformedBy, None if call.receipt is None else NamedNode(space.activity(call.receipt))),
    )
    times = call.created_ns, call.answered_ns
    outline = call_outline(call.id, call.service, call.state, times, call.words, space)
    return Document(url, (*outline, *triples), messages)


def call_outline(
    id: str, service: str, state: str, times_ns: tuple[int, int | None], words: str | None, space: Space
) -> list[Triple]:
    """Return the triples of a call that lists have, too: its service, its outcome, its times."""
    return triples_about(
        NamedNode(space.call(id)),
        (rdf.type, ros.Call),
        (ros.isCallOf, NamedNode(space.service(service))),
        (ros.state, ros.terms[state]),
        (prov.startedAtTime, date_time_literal(times_ns[0])),
        (prov.endedAtTime, date_time_literal(times_ns[1])),
        (ros.words, text(words)),
    )


_TERMS: Mapping[GoalStatus, NamedNode] = {status: ros.terms[status.value.capitalize()] for status in GoalStatus}


def action_document(
    action: Action, space: Space, graph: Graph, goals: Sequence[str] = (), *, takes_goals: bool = False
) -> Document:
    """Return the document of an action: its type, its servers and clients, the shapes of its messages, its goals.

    `takes_goals`: a goal can be sent here now, and a form says how.
    """
    url = space.action(action.name)
    subject = NamedNode(url)
    triples = triples_about(
        subject,
        (rdf.type, ros.Action),
        *RDF_SOURCE,
        (ros.name, text(action.name)),
        *_action_type(action, space),
        *statements(ros.provider, [NamedNode(space.node(node)) for node in dict.fromkeys(action.servers)]),
        *statements(ros.client, [NamedNode(space.node(node)) for node in dict.fromkeys(action.clients)]),
        (ros.unusable, text(action.unusable)),
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


def _action_type(action: Action, space: Space) -> list[Statement]:
    if action.type is None:
        return []
    name = action.type.name
    return [
        (ros.hasActionType, NamedNode(space.class_of(name))),
        (ros.goalShape, NamedNode(space.shape(f"{name}_Goal"))),
        (ros.resultShape, NamedNode(space.shape(f"{name}_Result"))),
        (ros.feedbackShape, NamedNode(space.shape(f"{name}_Feedback"))),
    ]


class GoalView(Struct, frozen=True, eq=False):
    """A goal as it is described; a message comes with its schema, feedback with when it came and its number.

    Times are wall-clock nanoseconds. `goal_id` is what its server knows it by. `cancelable`: it can be canceled here
    now, and a form says how. `receipt` is the id of the receipt of the request that sent it.
    """

    id: str
    action: str
    goal_id: str | None
    status: GoalStatus
    own: bool
    created_ns: int
    goal: tuple[MessageSchema, Message] | None = None
    feedback: tuple[MessageSchema, Message, Envelope] | None = None
    result: tuple[MessageSchema, Message] | None = None
    ended_ns: int | None = None
    words: str | None = None
    unreadable: str | None = None
    cancelable: bool = False
    receipt: str | None = None


def goal_document(goal: GoalView, space: Space, settings: LiftSettings = _SETTINGS) -> Document:
    """Return the document of a goal: its message, its status, the latest feedback, the result."""
    url = space.goal(goal.id)
    subject = NamedNode(url)
    messages: list[LiftedMessage] = []
    if goal.goal is not None:
        messages.append(LiftedMessage("#goal", lifter(goal.goal[0], settings), goal.goal[1]))
    if goal.feedback is not None:
        schema, message, envelope = goal.feedback
        messages.append(LiftedMessage("#feedback", lifter(schema, settings), message, envelope))
    if goal.result is not None:
        messages.append(LiftedMessage("#result", lifter(goal.result[0], settings), goal.result[1]))
    triples = goal_outline(goal.id, goal.action, goal.status, (goal.created_ns, goal.ended_ns), goal.words, space)
    triples += triples_about(
        subject,
        *RDF_SOURCE,
        (ros.goalId, text(goal.goal_id)),
        (ros.own, boolean(goal.own)),
        (prov.wasInformedBy, None if goal.receipt is None else NamedNode(space.activity(goal.receipt))),
        (ros.unreadable, text(goal.unreadable)),
        (ros.goalMessage, NamedNode(f"{url}#goal") if goal.goal else None),
        (ros.feedback, NamedNode(f"{url}#feedback") if goal.feedback else None),
        (ros.result, NamedNode(f"{url}#result") if goal.result else None),
    )
    if not goal.status.is_final:
        triples += affordance(subject, "events", td.hasEventAffordance, td.EventAffordance)
        events = NamedNode(f"{url}#events")
        triples += forms(events, "subscribe", "GET", td.subscribeEvent, url, STREAM, SSE)
    if goal.cancelable:
        triples += affordance(subject, "cancel", td.hasActionAffordance, td.ActionAffordance)
        triples += forms(NamedNode(f"{url}#cancel"), "cancel", "DELETE", td.cancelAction, url)
    return Document(url, tuple(triples), tuple(messages))


def goal_outline(
    id: str, action: str, status: GoalStatus, times_ns: tuple[int | None, int | None], words: str | None, space: Space
) -> list[Triple]:
    """Return the triples of a goal that lists have, too: its action, its status, when it was sent and when it ended."""
    return triples_about(
        NamedNode(space.goal(id)),
        (rdf.type, ros.Goal),
        (ros.isGoalOf, NamedNode(space.action(action))),
        (ros.status, _TERMS[status]),
        (ros.statusWord, text(status.value)),
        (ros.words, text(words)),
        (prov.startedAtTime, date_time_literal(times_ns[0])),
        (prov.endedAtTime, date_time_literal(times_ns[1])),
    )
