"""What predicates and classes tell of the nodes they are said of: whether live values can be meant, and whose. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple
from urllib.parse import unquote

from rosld.ontology.vocab import rdf, ros, td
from rosld.server.sparql.patterns import Iri, Pattern, Term, Variable


class Live(NamedTuple):
    """Which live values a pattern can match: those of topics (`messages`), those of parameters."""

    messages: bool
    parameters: bool

    def __or__(self, other: Live) -> Live:
        return Live(self.messages or other.messages, self.parameters or other.parameters)

    def __and__(self, other: Live) -> Live:
        return Live(self.messages and other.messages, self.parameters and other.parameters)


NEITHER, BOTH, MESSAGES, PARAMETERS = Live(False, False), Live(True, True), Live(True, False), Live(False, True)


@dataclass(frozen=True, slots=True)
class Said:
    """What is known of a node.

    `resource`: it is a resource itself, no message within one; `live`: the live values that can be said of it;
    `graphs`: where it can stand (None: anywhere); `types`: message types that the topic it belongs to must use.
    """

    resource: bool = False
    live: Live = BOTH
    graphs: frozenset[str] | None = None
    types: frozenset[str] = frozenset()

    def also(self, other: Said) -> Said:
        """Both at once."""
        return Said(
            self.resource or other.resource,
            self.live & other.live,
            _common(self.graphs, other.graphs),
            self.types | other.types,
        )


UNKNOWN = Said()
_TOPIC, _PARAMETER, _MESSAGE = Said(True, MESSAGES), Said(True, PARAMETERS), Said(False, MESSAGES)
_RESOURCE, _OTHER = Said(True), Said(True, NEITHER)


def _common(one: frozenset[str] | None, other: frozenset[str] | None) -> frozenset[str] | None:
    """What both allow. Where they exclude each other nothing can match; to be safe, what either allows."""
    if one is None or other is None:
        return other if one is None else one
    return (one & other) or (one | other)


_LIVE = frozenset(
    term.value
    for term in (
        ros.rate, ros.latest, ros.latestFrom, ros.received, ros.sequence, ros.dateTime, ros.elided, ros.length,
        ros.bytes, ros.unreadable, ros.age, rdf.first, rdf.rest,
    )
)  # fmt: skip
_WITHIN = frozenset({ros.latest.value, ros.latestFrom.value})
_STAYS = frozenset({ros.elided.value, rdf.first.value, rdf.rest.value}) | _WITHIN
_DESCRIBED = frozenset(
    term.value
    for term in (
        ros.name, ros.master, ros.uri, ros.runId, ros.messageType, ros.serviceType, ros.actionType, ros.conflictingType,
        ros.publishes, ros.subscribes, ros.provides, ros.subscriber, ros.provider, ros.endpoint, ros.node, ros.latched,
        ros.unreachable, ros.uncallable, ros.namespace, ros.writable, ros.simulatedTime, ros.service, ros.request,
        ros.response, ros.created, ros.answered, ros.words, ros.requestShape, ros.responseShape, ros.shape, ros.state,
        ros.staleSince, ros.reason, ros.definition, ros.md5, ros.typeHash, ros.variant, ros.field, ros.fieldName,
        ros.fieldType, ros.position, ros.arrayLength, ros.arrayBound, ros.stringBound, ros.constant, ros.nestedType,
        ros.requestType, ros.responseType, ros.bag, ros.format, ros.start, ros.end, ros.count, ros.topic, ros.message,
        ros.index, ros.recordedAt, ros.queryParameter, ros.text, ros.qos, ros.reliability, ros.durability, ros.history,
        ros.depth, ros.deadline, ros.lifespan, ros.liveliness, ros.lease, ros.qosMismatch, ros.policy, ros.offered,
        ros.requested, ros.qosMismatchCount, ros.readOnly, ros.parameterType, ros.step,
        ros.parameter, ros.lifecycleState, ros.lifecycleStateWord, ros.lifecycleUnknown, ros.transition, ros.goalState,
        ros.goalStateWord, ros.touches, ros.matched, ros.does, ros.duration, ros.digest, ros.excerpt, ros.withheld,
        ros.readsFrom, ros.writesTo, ros.invokes, ros.hasGoal,
    )
)  # fmt: skip
"""Never said of what is live. Terms of the vocabulary that are not listed anywhere here count as live."""
_PREDICATES: Mapping[str, Said] = {
    **{one.value: _TOPIC for one in (ros.rate, ros.latest, ros.latestFrom, ros.messageType)},
    **{one.value: _RESOURCE for one in (ros.name, ros.subscriber, ros.endpoint, ros.namespace, ros.conflictingType)},
    **{one.value: _OTHER for one in (ros.publishes, ros.subscribes, ros.provides, ros.parameter, ros.lifecycleState)},
    **{one.value: _MESSAGE for one in (ros.received, ros.sequence, ros.dateTime, ros.elided)},
    ros.value.value: _PARAMETER,
}
_CLASSES: Mapping[str, Said] = {
    ros.Topic.value: _TOPIC,
    ros.Parameter.value: _PARAMETER,
    ros.Message.value: _MESSAGE,
    ros.Elided.value: _MESSAGE,
    **{
        term.value: _OTHER
        for term in (
            ros.Graph, ros.Master, ros.Node, ros.Service, ros.Action, ros.Bag, ros.MessageType, ros.ServiceType,
            ros.ActionType, ros.Field, ros.Constant, ros.Query, ros.Write, ros.Qos, ros.QosMismatch, ros.ManagedNode,
            ros.ComplexResource, ros.Property, ros.Goal, ros.Hold, ros.Stop,
        )
    },
}  # fmt: skip

COMPLEX = frozenset(
    one.value
    for one in (
        ros.ComplexResource, td.PropertyAffordance, td.ActionAffordance, td.hasPropertyAffordance,
        td.hasActionAffordance,
    )
)  # fmt: skip
"""Said of every complex resource, beside the relations that mappings give some of them."""
PROPERTIES = frozenset(one.value for one in (ros.Property, ros.readsFrom, ros.writesTo, rdf.value))
"""Said of every property."""
ACTIONS = frozenset({ros.invokes.value})
"""Said of every action."""
_OF_RESOURCES = COMPLEX | PROPERTIES | ACTIONS


@dataclass(frozen=True, slots=True)
class Terms:
    """The vocabulary as seen by a query.

    `types` is the namespace of message types, `relations` are the predicates that mappings give complex resources.
    """

    types: str
    relations: frozenset[str] = frozenset()

    def type_named(self, iri: str) -> str | None:
        """The message type (`geometry_msgs/msg/Twist`) that an IRI is the class, or a property, of."""
        return unquote(document(iri[len(self.types) :])) if iri.startswith(self.types) else None

    def is_everywhere(self, iri: str) -> bool:
        """Whether live values of any graph can hold this IRI, of those that no description needs to hold."""
        return iri == rdf.nil.value or iri.startswith(self.types)

    def stays(self, predicate: str) -> bool:
        """Whether the object of a live triple with this predicate, if it is a node, stands in the same graph."""
        return predicate in _STAYS or predicate.startswith(self.types)

    def owns_object(self, pattern: Pattern) -> bool:
        """Whether the object is always a node of the graph that the pattern's match stands in."""
        return pattern.predicates is not None and not pattern.empty and pattern.predicates <= _WITHIN

    def only_live(self, pattern: Pattern) -> bool:
        """Whether only messages (of topics, calls, goals) are spoken of so, or topics of their messages."""
        return bool(self._field_of(pattern) or self._instance_of(pattern)) or self.owns_object(pattern)

    def says(self, pattern: Pattern) -> Said:
        """What a pattern tells of its subject."""
        if name := self._field_of(pattern) or self._instance_of(pattern):
            return replace(_MESSAGE, types=frozenset({name}))
        if pattern.empty or pattern.predicates is None or len(pattern.predicates) != 1:
            return UNKNOWN
        [predicate] = pattern.predicates
        if predicate == rdf.type.value and isinstance(pattern.object, Iri):
            return UNKNOWN if pattern.repeated else _CLASSES.get(pattern.object.value, UNKNOWN)
        if predicate == ros.messageType.value and isinstance(pattern.object, Iri) and not pattern.repeated:
            named = self.type_named(pattern.object.value)
            return replace(_TOPIC, types=frozenset({named}) if named else frozenset())
        return _PREDICATES.get(predicate, UNKNOWN)

    def _field_of(self, pattern: Pattern) -> str | None:
        """The one type whose field the first step must be."""
        names = {self.type_named(one) for one in pattern.predicates or ()}
        return names.pop() if len(names) == 1 and not pattern.empty else None

    def _instance_of(self, pattern: Pattern) -> str | None:
        is_type = pattern.predicates == frozenset({rdf.type.value}) and not pattern.repeated
        return self.type_named(pattern.object.value) if is_type and isinstance(pattern.object, Iri) else None

    def live(self, pattern: Pattern, subject: Said) -> Live:
        """The live values that the pattern can match, its subject being what it is."""
        found = NEITHER
        for predicate in pattern.predicates or (None,):
            found = found | self._live(predicate, pattern.object, subject.resource)
        return found & subject.live

    def _live(self, predicate: str | None, object: Term, resource: bool) -> Live:
        if predicate is None:
            return BOTH
        if predicate == rdf.type.value:
            return MESSAGES if self._live_class(object, resource) else NEITHER
        if predicate in _LIVE or predicate.startswith(self.types):
            return MESSAGES
        if predicate == ros.value.value:
            return PARAMETERS
        if predicate == ros.publisher.value:  # of a topic it is description, of a message not
            return NEITHER if resource else MESSAGES
        return BOTH if predicate.startswith(ros.iri) and predicate not in _DESCRIBED else NEITHER

    def of_resources(self, pattern: Pattern, subject: Said) -> frozenset[str]:
        """The terms of a pattern by which it names resources below `resources/`, its subject being what it is.

        A class names them whatever else is said of the subject; a predicate only where that can be one of them.
        """
        if pattern.predicates == frozenset({rdf.type.value}):
            named = frozenset({pattern.object.value}) if isinstance(pattern.object, Iri) else frozenset()
            return named & _OF_RESOURCES
        if subject.live != BOTH or pattern.predicates is None:
            return frozenset()
        return pattern.predicates & (_OF_RESOURCES | self.relations)

    def _live_class(self, object: Term, resource: bool) -> bool:
        if isinstance(object, Variable):
            return not resource
        return isinstance(object, Iri) and (
            object.value in (ros.Message.value, ros.Elided.value) or object.value.startswith(self.types)
        )


def document(iri: str) -> str:
    """The document an IRI points into: the IRI without its fragment."""
    return iri.partition("#")[0]
