"""What predicates and classes tell of the nodes they are said of: whether live values can be meant, and whose. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache, reduce
from typing import NamedTuple
from urllib.parse import unquote

from rosld.ontology.vocab import PREFIXES, prov, rdf, ros, td
from rosld.server.sparql.needs import tells_of_members
from rosld.server.sparql.syntax.tree import Iri, Pattern, Term, Variable


class LiveKinds(NamedTuple):
    """Kinds of what is not always in the dataset.

    Values of topics (`messages`) and of parameters, what lies below `/resources/`, and recorded messages.
    """

    messages: bool = False
    parameters: bool = False
    resources: bool = False
    records: bool = False

    def __or__(self, other: LiveKinds) -> LiveKinds:
        return LiveKinds(self[0] or other[0], self[1] or other[1], self[2] or other[2], self[3] or other[3])

    def __and__(self, other: LiveKinds) -> LiveKinds:
        return LiveKinds(self[0] and other[0], self[1] and other[1], self[2] and other[2], self[3] and other[3])


ANY, NEITHER = LiveKinds(True, True, True, True), LiveKinds()
_OF_MESSAGES = LiveKinds(messages=True, resources=True, records=True)
"""Of any message, wherever it is shown: as a topic's, as the value of a resource, as a recorded one."""
_BESIDE = LiveKinds(resources=True, records=True)


@dataclass(frozen=True, slots=True)
class NodeMeaning:
    """What is known of a node.

    `resource`: it is a resource itself, no message within one; `live`: the kinds of graphs it can be of; `types`: the
    message types that the topic it belongs to must use.
    """

    resource: bool = False
    live: LiveKinds = ANY
    types: frozenset[str] = frozenset()

    def combine(self, other: NodeMeaning) -> NodeMeaning:
        """Both at once."""
        return NodeMeaning(self.resource or other.resource, self.live & other.live, self.types | other.types)


UNKNOWN_NODE = NodeMeaning()
_TOPIC, _PARAMETER = NodeMeaning(True, LiveKinds(messages=True)), NodeMeaning(True, LiveKinds(parameters=True))
_MESSAGE, _BELOW = NodeMeaning(False, _OF_MESSAGES), NodeMeaning(True, LiveKinds(resources=True))
_RESOURCE, _OTHER = NodeMeaning(True), NodeMeaning(True, NEITHER)


_LIVE = frozenset(
    term.value
    for term in (
        ros.rate, ros.latest, ros.latestFrom, ros.received, ros.sequence, ros.dateTime, ros.sentBy,
        ros.elidedLength, ros.bytes, ros.unreadable, ros.age, rdf.first, rdf.rest,
    )
)  # fmt: skip
_STAYS = frozenset(one.value for one in (rdf.first, rdf.rest, ros.latest, ros.latestFrom, ros.recordedMessage))
_BELOW_RESOURCES = frozenset(
    one.value
    for one in (
        ros.name,
        ros.shape,
        ros.requestShape,
        ros.readsFrom,
        ros.writesTo,
        ros.invokes,
        ros.reason,
        ros.state,
        ros.words,
    )
)
"""Described, and said of what lies below `/resources/`, too."""
_OF_RECORDS = frozenset(
    one.value
    for one in (ros.recordedIn, ros.index, ros.onTopic, ros.recordedAt, ros.opensRecording, ros.recordedMessage)
)
"""Described, and said of recorded messages, too."""
_VOCABULARIES = tuple(iri for iri in PREFIXES.values() if not iri.startswith(ros.iri))
"""The namespaces of other terms that the server uses."""
_DESCRIBED = frozenset(
    term.value
    for term in (
        ros.name, ros.hasMaster, ros.uri, ros.runId, ros.hasMessageType, ros.hasServiceType, ros.hasActionType,
        ros.conflictingType, ros.publishes, ros.subscribes, ros.provides, ros.publishedBy, ros.subscribedBy,
        ros.provider, ros.hasEndpoint, ros.ofNode, ros.ofTopic, ros.latched, ros.unreachable, ros.uncallable,
        ros.namespace, ros.writable, ros.simulatedTime, ros.isCallOf, ros.request, ros.response,
        prov.startedAtTime, prov.endedAtTime, ros.words, ros.requestShape, ros.responseShape, ros.shape,
        ros.state, ros.staleSince, ros.reason, ros.definition, ros.md5, ros.typeHash, ros.variant, ros.hasField,
        ros.fieldName, ros.fieldType, ros.position, ros.arrayLength, ros.arrayBound, ros.stringBound,
        ros.hasConstant, ros.nestedType, ros.requestType, ros.responseType, ros.recordedIn,
        ros.hasRecordedTopic, ros.start, ros.end, ros.count, ros.onTopic, ros.recordedMessage, ros.index,
        ros.recordedAt, ros.queryParameter, ros.text, ros.hasQos, ros.reliability, ros.durability, ros.history,
        ros.depth, ros.deadline, ros.lifespan, ros.liveliness, ros.lease, ros.hasQosMismatch, ros.policy,
        ros.offered, ros.requested, ros.past, ros.qosMismatchCount, ros.readOnly, ros.parameterType, ros.step,
        ros.hasParameter, ros.lifecycleState, ros.lifecycleStateWord, ros.lifecycleUnknown, ros.transition,
        ros.targetState, ros.targetStateWord, ros.touches, ros.matched, ros.does, ros.duration, ros.digest,
        ros.excerpt, ros.withheld, ros.readsFrom, ros.writesTo, ros.invokes, ros.hasGoal, ros.isGoalOf,
        ros.opensRecording, ros.holds, ros.heldBy, ros.offeringNode, ros.requestingNode, ros.byteLength, ros.robot,
    )
)  # fmt: skip
"""Never said of what is live. Terms of the vocabulary that are not listed anywhere here count as live."""
_PREDICATES: Mapping[str, NodeMeaning] = {
    **{one.value: _TOPIC for one in (ros.rate, ros.latest, ros.latestFrom, ros.hasMessageType)},
    **{
        one.value: _RESOURCE
        for one in (ros.name, ros.publishedBy, ros.subscribedBy, ros.hasEndpoint, ros.namespace, ros.conflictingType)
    },
    **{
        one.value: _OTHER for one in (ros.publishes, ros.subscribes, ros.provides, ros.hasParameter, ros.lifecycleState)
    },
    **{one.value: _MESSAGE for one in (ros.received, ros.sequence, ros.dateTime, ros.sentBy)},
    ros.value.value: _PARAMETER,
}
_CLASSES: Mapping[str, NodeMeaning] = {
    ros.Topic.value: _TOPIC,
    ros.Parameter.value: _PARAMETER,
    ros.Message.value: _MESSAGE,
    ros.Elided.value: _MESSAGE,
    **{
        term.value: _OTHER
        for term in (
            ros.Graph, ros.Master, ros.Node, ros.Service, ros.Action, ros.Bag, ros.MessageType, ros.ServiceType,
            ros.ActionType, ros.Field, ros.Constant, ros.Query, ros.Write, ros.Qos, ros.QosMismatch, ros.ManagedNode,
            ros.Goal, ros.Hold, ros.Stop,
        )
    },
    ros.ComplexResource.value: _BELOW,
    ros.Property.value: _BELOW,
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
_OF_ONE_KIND = (
    frozenset(one.value for one in (ros.ComplexResource, ros.Property, ros.readsFrom, ros.writesTo)) | ACTIONS
)
"""Said of no other kind of what lies below `/resources/` than the one that they name."""


@dataclass(frozen=True, slots=True)
class VocabularyView:
    """The vocabulary as seen by a query.

    `types` is the namespace of message types, `relations` are the predicates that mappings give complex resources,
    `base` is what the IRIs of this server's resources begin with.
    """

    types: str
    base: str
    relations: frozenset[str] = frozenset()

    def type_named(self, iri: str) -> str | None:
        """The message type (`geometry_msgs/msg/Twist`) that an IRI is the class, or a property, of."""
        return _type_named(self.types, iri) if iri.startswith(self.types) else None

    def is_here(self, iri: str) -> bool:
        """Whether an IRI is one of this server's resources, or a fragment of one."""
        return iri.startswith(self.base)

    def stays_in_graph(self, pattern: Pattern) -> bool:
        """Whether a live match leads to a node of the graph it stands in, if it leads to a node that has triples."""
        return pattern.predicates is not None and all(map(self._stays, pattern.predicates))

    def _stays(self, predicate: str) -> bool:
        return predicate in _STAYS or predicate.startswith(self.types)

    def subject_meaning(self, pattern: Pattern) -> NodeMeaning:
        """What a pattern tells of its subject."""
        if name := self._field_of(pattern) or self._instance_of(pattern):
            return NodeMeaning(False, _OF_MESSAGES, frozenset({name}))
        if pattern.empty or pattern.predicates is None or len(pattern.predicates) != 1:
            return UNKNOWN_NODE
        [predicate] = pattern.predicates
        if predicate == rdf.type.value and isinstance(pattern.object, Iri):
            return UNKNOWN_NODE if pattern.repeated else _CLASSES.get(pattern.object.value, UNKNOWN_NODE)
        if predicate == ros.hasMessageType.value and isinstance(pattern.object, Iri) and not pattern.repeated:
            named = self.type_named(pattern.object.value)
            return NodeMeaning(True, _TOPIC.live, frozenset({named}) if named else frozenset())
        return _PREDICATES.get(predicate, UNKNOWN_NODE)

    def _field_of(self, pattern: Pattern) -> str | None:
        """The one type whose field the first step must be."""
        if pattern.empty or not pattern.predicates:
            return None
        names = {self.type_named(one) for one in pattern.predicates}
        return names.pop() if len(names) == 1 else None

    def _instance_of(self, pattern: Pattern) -> str | None:
        is_type = pattern.predicates == _TYPE and not pattern.repeated
        return self.type_named(pattern.object.value) if is_type and isinstance(pattern.object, Iri) else None

    def is_of_resource(self, pattern: Pattern, said: NodeMeaning) -> bool:
        """Whether the subject is a resource itself, no message within one; `said` is what the pattern says."""
        if pattern.repeated:
            return False
        return said.resource or (isinstance(pattern.subject, Iri) and "#" not in pattern.subject.value)

    def live_kinds(self, pattern: Pattern, resource: bool) -> LiveKinds:
        """The kinds of live values that the pattern can match; `resource`: its subject is a resource itself."""
        if pattern.predicates is None:
            return ANY
        object = _UNKNOWN if pattern.repeated else pattern.object
        found = (self._live(each, object, resource and not pattern.repeated) for each in pattern.predicates)
        return reduce(LiveKinds.__or__, found, NEITHER)

    def _live(self, predicate: str, object: Term, resource: bool) -> LiveKinds:
        if predicate == rdf.type.value:
            return self._live_class(object, resource)
        if predicate in _LIVE or predicate.startswith(self.types):
            return _OF_MESSAGES
        if predicate == ros.value.value:
            return LiveKinds(parameters=True)
        if predicate in _BELOW_RESOURCES or predicate in _OF_RECORDS:
            return LiveKinds(resources=predicate in _BELOW_RESOURCES, records=predicate in _OF_RECORDS)
        if predicate in _DESCRIBED:
            return NEITHER
        if predicate.startswith(ros.iri):
            return ANY
        return _BESIDE if predicate in self.relations or predicate.startswith(_VOCABULARIES) else NEITHER

    def _live_class(self, object: Term, resource: bool) -> LiveKinds:
        if isinstance(object, Variable):
            return _BESIDE._replace(messages=not resource)
        if not isinstance(object, Iri):
            return NEITHER
        if object.value in (ros.Message.value, ros.Elided.value) or object.value.startswith(self.types):
            return _OF_MESSAGES
        if object.value == ros.Record.value:
            return LiveKinds(records=True)
        if object.value in (ros.ServerStatus.value, ros.Mirror.value):
            return ANY
        if object.value.startswith(ros.iri):
            return LiveKinds(resources=object.value in _OF_RESOURCES)
        return _BESIDE if object.value.startswith(_VOCABULARIES) else NEITHER

    def names_resources(self, pattern: Pattern) -> bool:
        """Whether what it can match below `resources/` is all named by its class or its predicates."""
        spoken = self.defining_terms(pattern)
        return bool(spoken) and spoken <= _OF_ONE_KIND | self.relations

    def is_of_resources(self, iri: str) -> bool:
        """Whether an IRI lies below `resources/`."""
        return iri.startswith(self.base + "resources/")

    def is_of_server(self, pattern: Pattern) -> bool:
        """Whether it can match what the server says in its own vocabulary and others."""
        return pattern.predicates is None or any(
            each.startswith((ros.iri, *_VOCABULARIES)) for each in pattern.predicates
        )

    def is_of_parameters(self, iri: str) -> bool:
        """Whether an IRI is that of a parameter or of a tree of them."""
        return iri.startswith(self.base + "parameters/")

    def tells_of_members(self, iri: str) -> bool:
        """Whether an IRI is that of a container that tells what its members say of themselves, where it is named."""
        return iri.startswith(self.base) and tells_of_members(iri)

    def resource_terms(self, iris: Iterable[str]) -> frozenset[str]:
        """Those of the terms that name resources below `resources/`."""
        return frozenset(iris) & (_OF_RESOURCES | self.relations)

    def defining_terms(self, pattern: Pattern) -> frozenset[str]:
        """By what a client would have to say it: the class, or else the predicates."""
        is_class = pattern.predicates == _TYPE and not pattern.repeated
        if is_class and isinstance(pattern.object, Iri):
            return frozenset({pattern.object.value})
        return pattern.predicates or frozenset()


_UNKNOWN = Variable("")
_TYPE = frozenset({rdf.type.value})


@lru_cache(maxsize=4096)
def _type_named(types: str, iri: str) -> str:
    return unquote(document_of(iri[len(types) :]))


def document_of(iri: str) -> str:
    """The document an IRI points into: the IRI without its fragment."""
    return iri.partition("#")[0]
