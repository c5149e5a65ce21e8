"""Topics described: type, endpoints, rate, and the latest messages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache

from msgspec.structs import replace
from pyoxigraph import Literal, NamedNode, Triple

from rosld.adapters.model import Endpoint, Graph, Qos, Topic, TypeRef, mismatch_count, mismatches
from rosld.ontology.describe_holds import holdable as holdable_at
from rosld.ontology.document import Document, LiftedMessage
from rosld.ontology.names import is_namespace
from rosld.ontology.neutral_message import COMMANDS
from rosld.ontology.triples import RDF_SOURCE, Statement, boolean, double, integer, statements, text, triples_about
from rosld.ontology.urls import Space
from rosld.ontology.vocab import rdf, rdfs, ros

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
) -> Document:
    """Return a topic and its latest messages, the newest of each publisher in order of receipt (the newest last).

    The newest of all is `#message`; where several publish, each publisher's is linked by ros:latestFrom. `unreadable`
    says why messages cannot be decoded, and goes before what the topic says itself. `holdable`: the topic can be held
    here, and a form says how; `hold` is the id of the one that is on it.
    """
    url = space.topic(topic.name)
    subject = NamedNode(url)
    named = _with_fragments(messages, space)
    nodes = [NamedNode(url + message.node) for message in named]
    several = len(nodes) > 1 or len(topic.publishers) > 1
    triples = [
        *_description(topic, space, is_namespace(topic.name, graph.topics)),
        *triples_about(
            subject,
            (ros.unreadable, text(unreadable or topic.unreadable)),
            (ros.rate, None if rate is None else double(rate)),
            (ros.latest, nodes[-1] if nodes else None),
            (ros.heldBy, NamedNode(space.hold(hold)) if hold else None),
            *(statements(ros.latestFrom, nodes) if several else ()),
        ),
        *(_described_hold(topic, space) if holdable else ()),
    ]
    return Document(url, tuple(triples), named, graph.simulated_time)


def _described_hold(topic: Topic, space: Space) -> tuple[Triple, ...]:
    """Return the affordance of holding the topic."""
    name = None if topic.type is None else topic.type.name
    shape = None if name is None else space.shape(name)
    return tuple(holdable_at(space.topic(topic.name), shape, commands_velocity=name in COMMANDS))


def _with_fragments(messages: Sequence[LiftedMessage], space: Space) -> tuple[LiftedMessage, ...]:
    """The messages under fragments of their own: the newest is `#message`, the others are called by publisher."""
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
    """`#from/talker`. Dots are escaped, because a dot leads to a nested message (`#message.linear`)."""
    publisher = message.envelope.publisher if message.envelope else None
    return f"#from/{publisher.removeprefix(nodes).replace('.', '%2E')}" if publisher else "#from"


@lru_cache(maxsize=4096)
def _description(topic: Topic, space: Space, is_namespace: bool) -> tuple[Triple, ...]:
    """Return the part of the document that does not change with messages."""
    url = space.topic(topic.name)
    endpoints = [
        *endpoints_of(ros.Publisher, topic.publishers, topic, space),
        *endpoints_of(ros.Subscriber, topic.subscribers, topic, space),
    ]
    unfit = list(_mismatches(topic, space))
    triples = triples_about(
        NamedNode(url),
        (rdf.type, ros.Topic),
        *RDF_SOURCE,
        (ros.name, text(topic.name)),
        *_type(topic, space),
        *statements(ros.publishedBy, _nodes(topic.publishers, space)),
        *statements(ros.subscribedBy, _nodes(topic.subscribers, space)),
        *statements(ros.hasEndpoint, [node for node, _ in endpoints]),
        *statements(ros.hasQosMismatch, [node for node, _ in unfit]),
        (ros.qosMismatchCount, integer(mismatch_count(topic.publishers, topic.subscribers) if unfit else None)),
        (ros.namespace, NamedNode(url + "/") if is_namespace else None),
    )
    for _, said in (*endpoints, *unfit):
        triples += said
    for ref in topic.types:
        triples += type_url(ref, space)
    return tuple(triples)


def _type(topic: Topic, space: Space) -> list[Statement]:
    """Return the type with its shape, or the variants that contradict each other."""
    if topic.type is None:
        return statements(ros.conflictingType, [NamedNode(space.type(ref)) for ref in topic.types])
    name = topic.type.name
    return [(ros.hasMessageType, NamedNode(space.class_of(name))), (ros.shape, NamedNode(space.shape(name)))]


def type_url(ref: TypeRef, space: Space) -> list[Triple]:
    """Return the URL on this server that describes the class of a type."""
    return triples_about(NamedNode(space.class_of(ref.name)), (rdfs.isDefinedBy, NamedNode(space.type(ref.name))))


def _nodes(endpoints: Iterable[Endpoint], space: Space) -> list[NamedNode]:
    return [NamedNode(url) for url in dict.fromkeys(space.node(endpoint.node) for endpoint in endpoints)]


def endpoints_of(
    kind: NamedNode, endpoints: Iterable[Endpoint], topic: Topic, space: Space
) -> Iterator[tuple[NamedNode, list[Triple]]]:
    """Yield those endpoints (ros:Publisher, ros:Subscriber) that have more to say than that they are there, described.

    All of a topic, or all of one node on it.
    """
    url = space.topic(topic.name)
    role = "publisher" if kind == ros.Publisher else "subscriber"
    met: Counter[str] = Counter()
    for endpoint in endpoints:
        conflict = endpoint.type if len(topic.types) > 1 else None
        if not (endpoint.latched or endpoint.unreachable or endpoint.qos or conflict):
            continue
        met[endpoint.node] += 1
        path, ordinal = (role, *endpoint.node[1:].split("/")), met[endpoint.node]
        node = NamedNode(_numbered_fragment(space.fragment(url, *path), ordinal))
        qos = NamedNode(_numbered_fragment(space.fragment(url, "qos", *path), ordinal)) if endpoint.qos else None
        yield (
            node,
            triples_about(
                node,
                (rdf.type, ros.Endpoint),
                (rdf.type, kind),
                (ros.ofNode, NamedNode(space.node(endpoint.node))),
                (ros.ofTopic, NamedNode(url)),
                (ros.latched, boolean(True) if endpoint.latched else None),
                (ros.unreachable, text(endpoint.unreachable)),
                (ros.conflictingType, NamedNode(space.type(conflict)) if conflict else None),
                (ros.hasQos, qos),
            )
            + (_qos(qos, endpoint.qos) if qos and endpoint.qos else []),
        )


def _numbered_fragment(fragment: str, ordinal: int) -> str:
    """The fragment of a node's endpoint; where it has several of one role on a topic, they are counted from 2 on."""
    return f"{fragment};{ordinal}" if ordinal > 1 else fragment


def _qos(node: NamedNode, qos: Qos) -> list[Triple]:
    return triples_about(
        node,
        (rdf.type, ros.Qos),
        (ros.reliability, text(qos.reliability)),
        (ros.durability, text(qos.durability)),
        (ros.history, text(qos.history)),
        (ros.depth, integer(qos.depth or None)),
        (ros.deadline, _seconds(qos.deadline_ns)),
        (ros.lifespan, _seconds(qos.lifespan_ns)),
        (ros.liveliness, text(qos.liveliness)),
        (ros.lease, _seconds(qos.lease_ns)),
    )


def _seconds(nanoseconds: int | None) -> Literal | None:
    return None if nanoseconds is None else double(nanoseconds / 1e9)


def _mismatches(topic: Topic, space: Space) -> Iterator[tuple[NamedNode, list[Triple]]]:
    """Return the incompatible pairs of endpoints, and their number if there are too many."""
    for number, one in enumerate(mismatches(topic.publishers, topic.subscribers, _MAX_MISMATCHES), 1):
        node = NamedNode(space.fragment(space.topic(topic.name), "qos-mismatch", str(number)))
        yield (
            node,
            triples_about(
                node,
                (rdf.type, ros.QosMismatch),
                (ros.offeringNode, NamedNode(space.node(one.publisher))),
                (ros.requestingNode, NamedNode(space.node(one.subscriber))),
                (ros.policy, text(one.policy)),
                (ros.offered, text(one.offered)),
                (ros.requested, text(one.requested)),
            ),
        )
