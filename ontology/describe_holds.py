"""Documents of holds and of the stop, and the affordance of holding a topic."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from hashlib import sha256
from types import MappingProxyType

from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import Literal, NamedNode, Triple

from rosld.adapters.model import Message, MessageSchema
from rosld.ontology import kinds
from rosld.ontology.document import Document, LiftedMessage
from rosld.ontology.lift import LiftSettings, lifter
from rosld.ontology.node_shape import SOURCE, NodeShape, many, one, optional
from rosld.ontology.triples import BODIES, SSE, STREAM, Statement, affordance, double, forms
from rosld.ontology.urls import Space
from rosld.ontology.vocab import dcterms, js, prov, rdf, rdfs, ros, td

MAX_RATE = 50.0
"""Maximum publishing rate of a hold in Hz."""
MAX_LEASE = 5.0
"""Maximum number of seconds of a hold without renewal."""
MIN_OF_HOLDS = 1e-6
"""Minimum rate in Hz, and minimum lease and time in seconds."""
RATE = 10.0
"""Default publishing rate in Hz for velocity commands."""
LEASE = 1.0
"""Default number of seconds of a hold without renewal."""
_NO_DEFAULTS: Mapping[str, float] = MappingProxyType({})
HOLD = (
    "The message is published repeatedly until the lease ends, or for `for` seconds. PATCH of the new hold (Location) "
    "renews it, also with another message; DELETE ends it. At its end the message of `then` is published: zero for a "
    "velocity."
)
"""Explanation of holding a topic."""
MEANINGS = {
    "rate": "Messages per second.",
    "lease": "Seconds that it lasts without renewal.",
    "for": "Seconds that it lasts, instead of a lease.",
    "then": "The last message: zero, none, or the URL of one.",
}
_SETTINGS = LiftSettings()
PARAMETERS = "{?rate,lease,for,then}"
"""The parameters of a hold, as in a URI template (RFC 6570)."""
CONFIRM = "The id of the stop, which its page shows: required from unauthenticated clients."
CONFIRM_PARAMETER = "{?confirm}"
"""The parameter of a release, as in a URI template."""


class HoldOutline(Struct, frozen=True):
    """The part of a hold that lists include. Times are wall-clock nanoseconds."""

    id: str
    topic: str
    holder: str
    rate: float
    created_ns: int
    last_error: str | None


class HoldView(HoldOutline, frozen=True, eq=False):
    """A hold with all that its document describes; messages come with their schema.

    `is_timed`: the lease is the time requested by `for`. `is_changeable`: it can be changed and ended here now, and
    gets forms.
    """

    lease: float
    until_ns: int | None
    message: tuple[MessageSchema, Message]
    release_message: tuple[MessageSchema, Message] | None
    release_requested: str
    is_timed: bool = False
    is_changeable: bool = True


HOLD_OUTLINE = NodeShape[HoldOutline]("Hold", "a hold of a topic", ros.Hold).with_properties(
    one(rdfs.label, kinds.TEXT, lambda hold: f"Hold of {hold.topic}"),
    one(ros.holds, kinds.TOPIC, lambda hold: hold.topic),
    one(ros.holder, kinds.TEXT, lambda hold: hold.holder),
    one(ros.publishRate, kinds.POSITIVE, lambda hold: hold.rate),
    one(prov.startedAtTime, kinds.DATE_TIME, lambda hold: hold.created_ns),
    optional(ros.words, kinds.TEXT, lambda hold: hold.last_error),
)
_HOLD = NodeShape[HoldView](
    HOLD_OUTLINE.name,
    HOLD_OUTLINE.label,
    ros.Hold,
    *SOURCE,
    required=(ros.leaseTime, ros.heldMessage, ros.atTheEnd),
).with_properties(
    *HOLD_OUTLINE.properties,
    optional(ros.leaseTime, kinds.POSITIVE, lambda hold: hold.lease),
    optional(ros.leaseUntil, kinds.DATE_TIME, lambda hold: hold.until_ns),
    optional(ros.holdTime, kinds.POSITIVE, lambda hold: hold.lease if hold.is_timed else None),
    optional(ros.heldMessage, kinds.MESSAGE, lambda hold: "#message"),
    optional(ros.then, kinds.MESSAGE, lambda hold: "#then" if hold.release_message else None),
    optional(ros.atTheEnd, kinds.TEXT, lambda hold: hold.release_requested),
    many(td.hasEventAffordance, kinds.EVENT_AFFORDANCE),
    many(td.hasActionAffordance, kinds.ACTION_AFFORDANCE),
)


def hold_document(hold: HoldView, space: Space, settings: LiftSettings = _SETTINGS) -> Document:
    """Return the document of a hold: topic, message, rate, holder, lease, and the message published at its end."""
    url = space.hold(hold.id)
    subject = NamedNode(url)
    parts = {"#message": hold.message, "#then": hold.release_message}
    messages = [LiftedMessage(node, lifter(part[0], settings), part[1]) for node, part in parts.items() if part]
    triples = _HOLD.triples(subject, hold, space)
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


def holdable(
    topic: str, shape: str | None = None, *, commands_velocity: bool = False, document: str | None = None
) -> list[Triple]:
    """Return the affordance of holding the topic at this URL: an action, its message and parameters.

    `shape` is the URL of the shape of the message. If it `commands_velocity`, no parameter is required. The subject is
    the topic, or the resource described in another `document`.
    """
    subject = NamedNode(document or topic)
    about_it = HOLD if commands_velocity else f"{HOLD} `rate` is required."
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
    """A step of a stop: its description, its state, why it failed, and the URLs of its subjects.

    `subscribers` is the number of subscribers that received its message, None if it published none.
    """

    does: str
    state: NamedNode
    words: str | None = None
    touches: tuple[str, ...] = ()
    subscribers: int | None = None


class StopView(Struct, frozen=True):
    """The stop: the steps that stop the robot and, if it is stopped, by whom.

    `warning` is the reason why the robot may move nevertheless. `is_usable`: the robot can be stopped here, and the
    stop gets forms.
    """

    steps: Sequence[StepView]
    by: str | None = None
    since_ns: int | None = None
    reason: str | None = None
    warning: str | None = None
    is_usable: bool = True


_STOP = NodeShape[StopView]("Stop", "the stop of the robot", ros.Stop, *SOURCE).with_properties(
    one(rdfs.label, kinds.TEXT, lambda stop: "Stop of the robot"),
    one(ros.stopped, kinds.BOOLEAN, lambda stop: stop.by is not None),
    optional(ros.stoppedBy, kinds.TEXT, lambda stop: stop.by),
    optional(ros.stoppedAt, kinds.DATE_TIME, lambda stop: stop.since_ns),
    optional(ros.reason, kinds.TEXT, lambda stop: stop.reason),
    optional(ros.warning, kinds.TEXT, lambda stop: stop.warning),
    many(ros.stopStep, replace(kinds.FRAGMENT, shacl="sh:node <#StopStep>"), lambda stop: map(_fragment, stop.steps)),
    many(td.hasActionAffordance, kinds.ACTION_AFFORDANCE),
)
_STEP = NodeShape[StepView]("StopStep", "a step of the stop", target="sh:targetObjectsOf ros:stopStep").with_properties(
    one(rdfs.label, kinds.TEXT, lambda step: step.does),
    one(ros.state, kinds.STATE, lambda step: step.state),
    optional(ros.subscriberCount, kinds.COUNT, lambda step: step.subscribers),
    optional(ros.words, kinds.TEXT, lambda step: step.words),
    many(ros.touches, kinds.IRI, lambda step: step.touches),
)


def _fragment(step: StepView) -> str:
    """Return the fragment of a step, named by a digest of its description, which hides the number of steps."""
    return f"#step-{sha256(step.does.encode()).hexdigest()[:12]}"


def stop_document(stop: StopView, space: Space) -> Document:
    url = space.stop
    subject = NamedNode(url)
    triples = _STOP.triples(subject, stop, space)
    for step in stop.steps:
        triples += _STEP.triples(NamedNode(url + _fragment(step)), step, space)
    if stop.is_usable:
        triples += affordance(subject, "stop", td.hasActionAffordance, td.ActionAffordance)
        action = NamedNode(f"{url}#stop")
        triples += forms(action, "post", "POST", td.invokeAction, url, BODIES[:1])
        if stop.by is not None:
            template = f"{url}{CONFIRM_PARAMETER}"
            triples += forms(action, "delete", "DELETE", td.cancelAction, url, template=template)
            triples += _variable(action, "confirm", CONFIRM, (rdf.type, js.StringSchema))
    return Document(url, tuple(triples))


_VARIABLE = NodeShape[tuple[str, str, float | None]](
    "UriVariable", "a variable of a template", target="sh:targetObjectsOf td:hasUriTemplateSchema"
).with_properties(
    one(rdf.type, kinds.IRI),
    one(js.propertyName, kinds.TEXT, lambda of: of[0]),
    optional(dcterms.description, kinds.TEXT, lambda of: of[1]),
    optional(js.default, kinds.DOUBLE, lambda of: of[2]),
    optional(js.exclusiveMinimum, kinds.DOUBLE),
    optional(js.maximum, kinds.DOUBLE),
)


def _variables(subject: NamedNode, affordance: str, defaults: Mapping[str, float] = _NO_DEFAULTS) -> list[Triple]:
    """Return the parameters of a hold: its rate in Hz, its lease or time in seconds, and its final message."""
    action, positive = NamedNode(f"{subject.value}#{affordance}"), (js.exclusiveMinimum, double(0))
    kinds_of: Mapping[str, Sequence[Statement]] = {
        "rate": ((rdf.type, js.NumberSchema), positive, (js.maximum, double(MAX_RATE))),
        "lease": ((rdf.type, js.NumberSchema), positive, (js.maximum, double(MAX_LEASE))),
        "for": ((rdf.type, js.NumberSchema), positive),
        "then": ((rdf.type, js.StringSchema),),
    }
    triples: list[Triple] = []
    for name, more in kinds_of.items():
        triples += _variable(action, name, MEANINGS[name], *more, default=defaults.get(name))
    return triples


def _variable(
    action: NamedNode, name: str, meaning: str, *more: Statement, default: float | None = None
) -> list[Triple]:
    variable = NamedNode(f"{action.value}/{name}")
    schema = _VARIABLE.triples(variable, (name, meaning, default), None, *more)
    return [Triple(action, td.hasUriTemplateSchema, variable), *schema]
