"""Documents of topics: type, endpoints, rate, and the latest messages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from itertools import chain

from msgspec.structs import replace
from pyoxigraph import NamedNode, Triple

from rosld.adapters.model import Endpoint, Graph, MessageSchema, Qos, Topic, TypeRef, mismatch_count, mismatches
from rosld.adapters.model.qos import Mismatch
from rosld.ontology import kinds
from rosld.ontology.describe_body import Source, body_links, sources_of_topic
from rosld.ontology.describe_holds import holdable as holdable_at
from rosld.ontology.document import Document, LiftedMessage
from rosld.ontology.names import is_namespace
from rosld.ontology.neutral_message import COMMANDS
from rosld.ontology.node_shape import SOURCE, NodeShape, many, one, optional
from rosld.ontology.observations import Role, device_triples, role_of
from rosld.ontology.triples import double, integer, statements, text, triples_about
from rosld.ontology.urls import Space
from rosld.ontology.vocab import rdf, rdfs, ros, td

MESSAGE = "#message"
_MAX_MISMATCHES = 50


def topic_document(
    topic: Topic,
    space: Space,
    graph: Graph,
    rate: float | None = None,
    messages: Sequence[LiftedMessage] = (),
    *,
    unreadable: str | None = None,
    holdable: bool = False,
    hold: str | None = None,
    schema: MessageSchema | None = None,
) -> Document:
    """Return a topic and its latest messages, the newest of each publisher in order of receipt (the newest last).

    The newest of all is `#message`; with several publishers, ros:latestFrom links each one's. `unreadable` is the
    reason why messages cannot be decoded, and precedes the topic's own. `holdable`: the topic can be held here, and
    gets a form; `hold` is the id of the current hold. `schema` is that of its type, if known.
    """
    url = space.topic(topic.name)
    subject = NamedNode(url)
    named = _with_fragments(messages, space)
    nodes = [NamedNode(url + message.node) for message in named]
    several = len(nodes) > 1 or len(topic.publishers) > 1
    triples = [
        *_description(topic, space, is_namespace(topic.name, graph.topics), holdable, sources_of_topic(topic, graph)),
        *_device(topic, role_of(topic, graph, schema), schema, space),
        *triples_about(
            subject,
            (ros.unreadable, text(unreadable or topic.unreadable)),
            (ros.rate, None if rate is None else double(rate)),
            (ros.latest, nodes[-1] if nodes else None),
            (ros.heldBy, NamedNode(space.hold(hold)) if hold else None),
            *(statements(ros.latestFrom, nodes) if several else ()),
        ),
    ]
    return Document(url, tuple(triples), named, graph.simulated_time)


def _with_fragments(messages: Sequence[LiftedMessage], space: Space) -> tuple[LiftedMessage, ...]:
    """Return the messages with fragments: the newest is `#message`, the others are named after their publishers."""
    if len(messages) < 2:
        return tuple(messages)
    nodes = space.container("nodes")
    taken = {MESSAGE}
    named: list[LiftedMessage] = [replace(messages[-1], node=MESSAGE)]
    for message in reversed(messages[:-1]):
        node = _fragment(message, nodes)
        while node in taken:  # several messages of one publisher
            node = f"{node};{message.envelope.sequence if message.envelope else len(taken)}"
        taken.add(node)
        named.append(replace(message, node=node))
    return tuple(reversed(named))


def _fragment(message: LiftedMessage, nodes: str) -> str:
    """Return a fragment such as `#from/talker`. Dots are escaped, as they lead to nested messages."""
    publisher = message.envelope.publisher if message.envelope else None
    return f"#from/{publisher.removeprefix(nodes).replace('.', '%2E')}" if publisher else "#from"


_TOPIC = NodeShape[Topic]("Topic", "a topic", ros.Topic, *SOURCE, is_listed=True).with_properties(
    one(ros.name, kinds.NAME, lambda topic: topic.name),
    optional(ros.hasMessageType, kinds.CLASS, lambda topic: topic.type),
    optional(ros.shape, kinds.SHAPE, lambda topic: topic.type),
    many(ros.conflictingType, kinds.TYPE, lambda topic: () if topic.type else topic.types),
    many(ros.publishedBy, kinds.NODE, lambda topic: dict.fromkeys(each.node for each in topic.publishers)),
    many(ros.subscribedBy, kinds.NODE, lambda topic: dict.fromkeys(each.node for each in topic.subscribers)),
    many(ros.hasEndpoint, kinds.ENDPOINT),
    many(ros.hasQosMismatch, kinds.IRI.where("sh:class ros:QosMismatch")),
    optional(ros.qosMismatchCount, kinds.COUNT),
    optional(ros.namespace, kinds.TOPIC),
    optional(ros.unreadable, kinds.TEXT),
    optional(ros.rate, kinds.AMOUNT),
    optional(ros.latest, kinds.MESSAGE),
    many(ros.latestFrom, kinds.MESSAGE),
    optional(ros.heldBy, kinds.HOLD),
    optional(ros.describesBody, kinds.IRI),
    optional(ros.sensor, kinds.FRAGMENT.where("sh:class sosa:Sensor")),
    optional(ros.actuator, kinds.FRAGMENT.where("sh:class sosa:Actuator")),
    many(td.hasActionAffordance, kinds.ACTION_AFFORDANCE),
)
_ENDPOINT = NodeShape[tuple[Endpoint, Topic]]("Endpoint", "a publisher or a subscriber", ros.Endpoint).with_properties(
    many(rdf.type, kinds.IRI.where("sh:in ( ros:Endpoint ros:Publisher ros:Subscriber )"), minimum=1),
    one(ros.ofNode, kinds.NODE, lambda of: of[0].node),
    one(ros.ofTopic, kinds.TOPIC, lambda of: of[1].name),
    optional(ros.latched, kinds.FLAG, lambda of: of[0].latched or None),
    optional(ros.unreachable, kinds.TEXT, lambda of: of[0].unreachable),
    optional(ros.conflictingType, kinds.TYPE, lambda of: _conflict(*of)),
    optional(ros.hasQos, kinds.IRI.where("sh:class ros:Qos")),
)
_QOS = NodeShape[Qos]("Qos", "a quality of service", ros.Qos).with_properties(
    optional(ros.reliability, kinds.TEXT, lambda qos: qos.reliability),
    optional(ros.durability, kinds.TEXT, lambda qos: qos.durability),
    optional(ros.history, kinds.TEXT, lambda qos: qos.history),
    optional(ros.depth, kinds.COUNT, lambda qos: qos.depth or None),
    optional(ros.deadline, kinds.SECONDS, lambda qos: qos.deadline_ns),
    optional(ros.lifespan, kinds.SECONDS, lambda qos: qos.lifespan_ns),
    optional(ros.liveliness, kinds.TEXT, lambda qos: qos.liveliness),
    optional(ros.lease, kinds.SECONDS, lambda qos: qos.lease_ns),
)
_MISMATCH = NodeShape[Mismatch]("QosMismatch", "a mismatch of quality of service", ros.QosMismatch).with_properties(
    one(ros.offeringNode, kinds.NODE, lambda pair: pair.publisher),
    one(ros.requestingNode, kinds.NODE, lambda pair: pair.subscriber),
    one(ros.policy, kinds.TEXT, lambda pair: pair.policy),
    optional(ros.offered, kinds.TEXT, lambda pair: pair.offered),
    optional(ros.requested, kinds.TEXT, lambda pair: pair.requested),
)


@lru_cache(maxsize=4096)
def _description(
    topic: Topic, space: Space, is_namespace: bool, holdable: bool, of_body: tuple[Source, ...]
) -> tuple[Triple, ...]:
    """Return the part of the document that does not change with messages."""
    url = space.topic(topic.name)
    endpoints = dict(
        chain(
            endpoints_of(ros.Publisher, topic.publishers, topic, space),
            endpoints_of(ros.Subscriber, topic.subscribers, topic, space),
        )
    )
    pairs = {
        NamedNode(space.fragment(url, "qos-mismatch", str(number))): pair
        for number, pair in enumerate(mismatches(topic.publishers, topic.subscribers, _MAX_MISMATCHES), 1)
    }
    triples = _TOPIC.triples(
        NamedNode(url),
        topic,
        space,
        *statements(ros.hasEndpoint, endpoints),
        *statements(ros.hasQosMismatch, pairs),
        (ros.qosMismatchCount, integer(mismatch_count(topic.publishers, topic.subscribers) if pairs else None)),
        (ros.namespace, NamedNode(url + "/") if is_namespace else None),
    )
    triples += body_links(url, ros.describesBody, of_body, space)
    for described in endpoints.values():
        triples += described
    for node, pair in pairs.items():
        triples += _MISMATCH.triples(node, pair, space)
    for ref in topic.types:
        triples += type_url(ref, space)
    if holdable:
        name = None if topic.type is None else topic.type.name
        shape = None if name is None else space.shape(name)
        triples += holdable_at(url, shape, commands_velocity=name in COMMANDS)
    return tuple(triples)


@lru_cache(maxsize=4096)
def _device(topic: Topic, role: Role | None, schema: MessageSchema | None, space: Space) -> Sequence[Triple]:
    return device_triples(topic, role, schema, space) if role is not None else ()


def type_url(ref: TypeRef, space: Space) -> list[Triple]:
    """Return the URL on this server that describes the class of a type."""
    return triples_about(NamedNode(space.class_of(ref.name)), (rdfs.isDefinedBy, NamedNode(space.type(ref.name))))


def endpoints_of(
    kind: NamedNode, endpoints: Iterable[Endpoint], topic: Topic, space: Space
) -> Iterator[tuple[NamedNode, list[Triple]]]:
    """Yield the descriptions of those endpoints (ros:Publisher, ros:Subscriber) that have any.

    These are all endpoints of a topic, or all those of one node on it.
    """
    url = space.topic(topic.name)
    role = "publisher" if kind == ros.Publisher else "subscriber"
    met: Counter[str] = Counter()
    for endpoint in endpoints:
        if not (endpoint.latched or endpoint.unreachable or endpoint.qos or _conflict(endpoint, topic)):
            continue
        met[endpoint.node] += 1
        path, ordinal = (role, *endpoint.node[1:].split("/")), met[endpoint.node]
        node = NamedNode(_numbered_fragment(space.fragment(url, *path), ordinal))
        qos = NamedNode(_numbered_fragment(space.fragment(url, "qos", *path), ordinal)) if endpoint.qos else None
        triples = _ENDPOINT.triples(node, (endpoint, topic), space, (rdf.type, kind), (ros.hasQos, qos))
        yield node, triples + (_QOS.triples(qos, endpoint.qos, space) if qos and endpoint.qos else [])


def _conflict(endpoint: Endpoint, topic: Topic) -> TypeRef | None:
    """Return the type of an endpoint of a topic with several types."""
    return endpoint.type if len(topic.types) > 1 else None


def _numbered_fragment(fragment: str, ordinal: int) -> str:
    """Return the fragment of a node's endpoint; several of one role on a topic are numbered from 2."""
    return f"{fragment};{ordinal}" if ordinal > 1 else fragment
