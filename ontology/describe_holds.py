"""Documents of holds and of the stop, and the affordance of holding a topic."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from hashlib import sha256
from types import MappingProxyType

from msgspec import Struct
from pyoxigraph import Literal, NamedNode, Triple

from rosld.adapters.model import Message, MessageSchema
from rosld.ontology.document import Document, LiftedMessage
from rosld.ontology.lift import LiftSettings, lifter
from rosld.ontology.triples import (
    BODIES,
    RDF_SOURCE,
    SSE,
    STREAM,
    Statement,
    affordance,
    boolean,
    date_time_literal,
    double,
    forms,
    integer,
    statements,
    text,
    triples_about,
)
from rosld.ontology.urls import Space
from rosld.ontology.vocab import dcterms, js, prov, rdf, rdfs, ros, td

MAX_RATE = 50.0
"""Hz: how often a hold may publish."""
MAX_LEASE = 5.0
"""Seconds that a hold may go on without being renewed."""
MIN_OF_HOLDS = 1e-6
"""The least rate in Hz, and the least lease and time in seconds."""
RATE = 10.0
"""Hz: how often a command of a velocity is published where nothing is said."""
LEASE = 1.0
"""Seconds that a hold goes on without being renewed, where nothing is said."""
_NO_DEFAULTS: Mapping[str, float] = MappingProxyType({})
HOLD = (
    "The message is published again and again until the lease ends, or for as many seconds as `for` says. PATCH of the "
    "hold that is made (Location) renews it, also with another message; DELETE ends it. Then what `then` says is "
    "published: zero for a velocity."
)
"""What it means to hold a topic."""
MEANINGS = {
    "rate": "How many times a second the message is published.",
    "lease": "The seconds that the hold goes on unrenewed.",
    "for": "Instead of a lease: the seconds after which the hold ends of itself.",
    "then": "What is published when the hold ends: zero, none, or the URL of a message.",
}
_SETTINGS = LiftSettings()
PARAMETERS = "{?rate,lease,for,then}"
"""Those of a hold, as in a URI template (RFC 6570)."""
CONFIRM = "The id of the stop, which its page shows: needed of those who have not said who they are."
CONFIRM_PARAMETER = "{?confirm}"
"""The parameter of a release, as in a URI template."""


class HoldView(Struct, frozen=True, eq=False):
    """A hold as it is described; messages come with their schema. Times are wall-clock nanoseconds.

    `is_timed`: the lease is the time that `for` asked for. `is_changeable`: it can be changed and ended here now, and
    forms say how.
    """

    id: str
    topic: str
    holder: str
    rate: float
    lease: float
    until_ns: int | None
    created_ns: int
    message: tuple[MessageSchema, Message]
    release_message: tuple[MessageSchema, Message] | None
    release_requested: str
    last_error: str | None = None
    is_timed: bool = False
    is_changeable: bool = True


def hold_document(hold: HoldView, space: Space, settings: LiftSettings = _SETTINGS) -> Document:
    """Return the document of a hold: topic, message, rate, holder, lease, and what is published at its end."""
    url = space.hold(hold.id)
    subject = NamedNode(url)
    messages = [LiftedMessage("#message", lifter(hold.message[0], settings), hold.message[1])]
    if hold.release_message is not None:
        messages.append(LiftedMessage("#then", lifter(hold.release_message[0], settings), hold.release_message[1]))
    triples = hold_outline(hold.id, hold.topic, hold.holder, hold.rate, hold.created_ns, hold.last_error, space)
    triples += triples_about(
        subject,
        *RDF_SOURCE,
        (ros.leaseTime, double(hold.lease)),
        (ros.leaseUntil, date_time_literal(hold.until_ns)),
        (ros.holdTime, double(hold.lease) if hold.is_timed else None),
        (ros.heldMessage, NamedNode(f"{url}#message")),
        (ros.then, NamedNode(f"{url}#then") if hold.release_message else None),
        (ros.atTheEnd, text(hold.release_requested)),
    )
    if hold.is_changeable:
        triples += affordance(subject, "renew", td.hasActionAffordance, td.ActionAffordance)
        renew = NamedNode(f"{url}#renew")
        triples += forms(renew, "patch", "PATCH", td.invokeAction, url, BODIES, template=f"{url}{PARAMETERS}")
        triples += _variables(subject, "renew")
        triples += affordance(subject, "keep", td.hasEventAffordance, td.EventAffordance)
        keep = NamedNode(f"{url}#keep")
        triples += forms(keep, "get", "GET", td.subscribeEvent, f"{url}?keep=true", STREAM, SSE)
        triples += affordance(subject, "end", td.hasActionAffordance, td.ActionAffordance)
        triples += forms(NamedNode(f"{url}#end"), "delete", "DELETE", td.cancelAction, url)
    return Document(url, tuple(triples), tuple(messages))


def hold_outline(
    id: str, topic: str, holder: str, rate: float, created_ns: int, last_error: str | None, space: Space
) -> list[Triple]:
    """The triples of a hold that lists have, too: its topic, its holder, since when, and its last error."""
    return triples_about(
        NamedNode(space.hold(id)),
        (rdf.type, ros.Hold),
        (ros.holds, NamedNode(space.topic(topic))),
        (ros.holder, text(holder)),
        (ros.publishRate, double(rate)),
        (prov.startedAtTime, date_time_literal(created_ns)),
        (ros.words, text(last_error)),
    )


def holdable(
    topic: str, shape: str | None = None, *, commands_velocity: bool = False, document: str | None = None
) -> list[Triple]:
    """Return the statements that the topic at this URL can be held: an action, its message and parameters.

    `shape` is the URL of the shape of the message. Where it `commands_velocity` no parameter has to be given. It is
    said of the topic, or of the resource that is described in another `document`.
    """
    subject = NamedNode(document or topic)
    about_it = HOLD if commands_velocity else f"{HOLD} Say how often: rate."
    return [
        *affordance(
            subject,
            "hold",
            td.hasActionAffordance,
            td.ActionAffordance,
            (dcterms.title, Literal("Hold the topic")),
            (dcterms.description, Literal(about_it)),
            (ros.requestShape, None if shape is None else NamedNode(shape)),
        ),
        *forms(
            NamedNode(f"{subject.value}#hold"),
            "post",
            "POST",
            td.invokeAction,
            topic,
            BODIES,
            template=f"{topic}{PARAMETERS}",
        ),
        *_variables(subject, "hold", {"lease": LEASE, **({"rate": RATE} if commands_velocity else {})}),
    ]


class StepView(Struct, frozen=True):
    """A step of a stop: what it does in words, its state, why it failed, and the URLs of what it is about.

    `subscribers` is how many got the message that it published, None where it published none.
    """

    does: str
    state: NamedNode
    words: str | None = None
    touches: tuple[str, ...] = ()
    subscribers: int | None = None


def stop_document(
    space: Space,
    steps: Sequence[StepView],
    *,
    by: str | None = None,
    since_ns: int | None = None,
    reason: str | None = None,
    warning: str | None = None,
    usable: bool = True,
) -> Document:
    """Return the stop: whether the robot is stopped (`by` somebody), and what is done to stop it.

    `warning` says why it may go on moving all the same. `usable`: the robot can be stopped here, and forms say how.
    """
    url = space.stop
    subject = NamedNode(url)
    nodes = [_step_node(url, step) for step in steps]
    triples = triples_about(
        subject,
        (rdf.type, ros.Stop),
        *RDF_SOURCE,
        (ros.stopped, boolean(by is not None)),
        (ros.stoppedBy, text(by)),
        (ros.stoppedAt, date_time_literal(since_ns)),
        (ros.reason, text(reason)),
        (ros.warning, text(warning)),
        *statements(ros.stopStep, nodes),
    )
    for node, step in zip(nodes, steps, strict=True):
        triples += triples_about(node, *_step_statements(step))
    if usable:
        triples += affordance(subject, "stop", td.hasActionAffordance, td.ActionAffordance)
        stop = NamedNode(f"{url}#stop")
        triples += forms(stop, "post", "POST", td.invokeAction, url, BODIES[:1])
        if by is not None:
            template = f"{url}{CONFIRM_PARAMETER}"
            triples += forms(stop, "delete", "DELETE", td.cancelAction, url, template=template)
            confirm = NamedNode(f"{stop.value}/confirm")
            triples.append(Triple(stop, td.hasUriTemplateSchema, confirm))
            named = (js.propertyName, Literal("confirm"))
            triples += triples_about(
                confirm, (rdf.type, js.StringSchema), named, (dcterms.description, Literal(CONFIRM))
            )
    return Document(url, tuple(triples))


def _step_statements(step: StepView) -> tuple[Statement, ...]:
    return (
        (rdfs.label, text(step.does)),
        (ros.state, step.state),
        (ros.subscriberCount, integer(step.subscribers)),
        (ros.words, text(step.words)),
        *statements(ros.touches, map(NamedNode, step.touches)),
    )


def _step_node(url: str, step: StepView) -> NamedNode:
    """Return the node of a step, named by a digest of its description, which hides the number of steps."""
    return NamedNode(f"{url}#step-{sha256(step.does.encode()).hexdigest()[:12]}")


def _variables(subject: NamedNode, affordance: str, defaults: Mapping[str, float] = _NO_DEFAULTS) -> list[Triple]:
    """The parameters of a hold: its rate in Hz, its lease or time in seconds, and what is published when it ends."""
    node = NamedNode(f"{subject.value}#{affordance}")
    said: Iterable[tuple[str, NamedNode, float | None]] = (
        ("rate", js.NumberSchema, MAX_RATE),
        ("lease", js.NumberSchema, MAX_LEASE),
        ("for", js.NumberSchema, math.inf),
        ("then", js.StringSchema, None),
    )
    triples: list[Triple] = []
    for name, kind, limit in said:
        variable = NamedNode(f"{node.value}/{name}")
        triples.append(Triple(node, td.hasUriTemplateSchema, variable))
        triples += triples_about(
            variable,
            (rdf.type, kind),
            (js.propertyName, Literal(name)),
            (dcterms.description, Literal(MEANINGS[name])),
            (js.default, double(defaults[name]) if name in defaults else None),
            (js.exclusiveMinimum, None if limit is None else double(0)),
            (js.maximum, None if limit in (None, math.inf) else double(limit)),
        )
    return triples
