"""The computation graph as a diagram of nodes, topics, services, actions and problems, and its folding. No I/O."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from enum import Enum
from urllib.parse import quote

from msgspec import Struct, field
from msgspec.structs import replace

from rosld.adapters.model import Graph, Topic, names
from rosld.adapters.model.qos import Mismatch, mismatches
from rosld.ontology.urls import Space

_MAX_MISMATCHES = 50
_OF_ROS = frozenset({"/rosout", "/rosout_agg", "/parameter_events", "/clock"})
"""Topics that every node uses, which would obscure the diagram."""
_OF_NODES = frozenset(
    {
        "describe_parameters", "get_parameter_types", "get_parameters", "list_parameters", "set_parameters",
        "set_parameters_atomically", "get_loggers", "set_logger_level", "get_logger_levels", "set_logger_levels",
        "get_type_description", "change_state", "get_state", "get_available_states", "get_available_transitions",
        "get_transition_graph",
    }
)  # fmt: skip
"""Services that every node provides, by the last segments of their names."""


class VertexKind(Enum):
    """Kind of a vertex; the value is its singular noun, whose plural ends in s."""

    NODE = "node"
    TOPIC = "topic"
    SERVICE = "service"
    ACTION = "action"


class Vertex(Struct, frozen=True):
    """A thing in the graph, or `count` things folded into one vertex.

    `rate` is in messages per second, or 0.0 if unknown; `problem` is a text or empty. A topic that `is_unheard` has no
    subscribers, which is not a problem.
    """

    key: str
    kind: VertexKind
    name: str
    url: str
    rate: float = 0.0
    problem: str = ""
    count: int = 1
    is_unheard: bool = False


class Traffic(Struct, frozen=True):
    """Observations of a topic that are not in the computation graph.

    `rate` is in messages per second, or 0.0 before it is measured; `silence` is a text about a topic whose messages
    have stopped; the others are whether the server itself publishes or subscribes to the topic.
    """

    rate: float = 0.0
    silence: str = ""
    is_published: bool = False
    is_subscribed: bool = False


class Edge(Struct, frozen=True):
    """The path of messages, calls or goals from one vertex to another, by their keys."""

    source: str
    target: str
    rate: float = 0.0
    problem: str = ""


class Diagram(Struct, frozen=True):
    """A diagram; `total` is the number of things in all vertices."""

    vertices: tuple[Vertex, ...]
    edges: tuple[Edge, ...]
    total: int

    @property
    def problems(self) -> Sequence[tuple[Vertex, str]]:
        """Return the problems with their vertices; the problem of an edge has the edge's target."""
        by_key = {each.key: each for each in self.vertices}
        found = [(each, each.problem) for each in self.vertices if each.problem]
        ends = ((by_key[each.target], by_key[each.source].name, each.problem) for each in self.edges)
        return [*found, *((target, f"{source}: {problem}") for target, source, problem in ends if problem)]


class Selection(Struct, frozen=True):
    """Part of a graph to draw: the things `below` a name and those connected to them, or all.

    Things that all nodes share are omitted, except with `everything`.
    """

    below: str = ""
    everything: bool = False


class _Draft(Struct):
    """A diagram under construction: vertices by key, edges by the keys of both ends."""

    vertices: dict[str, Vertex] = field(default_factory=dict)
    edges: dict[tuple[str, str], Edge] = field(default_factory=dict)

    def connect(self, source: str, target: str, rate: float = 0.0, problem: str = "") -> None:
        if source in self.vertices and target in self.vertices:
            known = self.edges.get((source, target))
            self.edges[source, target] = Edge(source, target, rate, problem or (known.problem if known else ""))


def draw_graph(
    graph: Graph,
    space: Space,
    selection: Selection,
    traffic: Callable[[Topic], Traffic],
    may_read: Callable[[str], bool],
) -> Diagram:
    """Return the diagram of a graph, without things that may not be read. `traffic` is called once per topic."""
    draft = _Draft()
    for vertex in _vertices(graph, space, selection, traffic):
        if may_read(vertex.url):
            draft.vertices[vertex.key] = vertex
    for topic in graph.topics.values():
        _connect_topic(draft, topic)
    for service in graph.services.values():
        for node in service.providers:
            draft.connect(_key(VertexKind.SERVICE, service.name), _key(VertexKind.NODE, node))
    for action in graph.actions.values():
        own = _key(VertexKind.ACTION, action.name)
        for node in action.clients:
            draft.connect(_key(VertexKind.NODE, node), own)
        for node in action.servers:
            draft.connect(own, _key(VertexKind.NODE, node))
    whole = Diagram(tuple(draft.vertices.values()), tuple(draft.edges.values()), len(draft.vertices))
    return _select(whole, selection.below) if selection.below not in ("", "/") else whole


def _key(kind: VertexKind, name: str) -> str:
    return f"{kind.value} {name}"


def _vertices(
    graph: Graph, space: Space, selection: Selection, traffic: Callable[[Topic], Traffic]
) -> Iterator[Vertex]:
    for name, node in sorted(graph.nodes.items()):
        problem = f"does not answer: {node.unreachable}" if node.unreachable else ""
        yield Vertex(_key(VertexKind.NODE, name), VertexKind.NODE, name, space.node(name), problem=problem)
    for name, topic in sorted(graph.topics.items()):
        if selection.everything or not (name in _OF_ROS or graph.is_of_action(name)):
            yield _topic_vertex(topic, graph.own_node, space.topic(name), traffic(topic))
    for name, service in sorted(graph.services.items()):
        if selection.everything or not (name.rpartition("/")[2] in _OF_NODES or names.action_of(name)):
            problem = f"cannot be called: {service.uncallable}" if service.uncallable else ""
            yield Vertex(_key(VertexKind.SERVICE, name), VertexKind.SERVICE, name, space.service(name), 0.0, problem)
    for name in sorted(graph.actions):
        yield Vertex(_key(VertexKind.ACTION, name), VertexKind.ACTION, name, space.action(name))


def _topic_vertex(topic: Topic, own_node: str, url: str, traffic: Traffic) -> Vertex:
    """Return the vertex of a topic. A topic without publishers is a problem, one without subscribers is not."""
    is_awaited = any(each.node != own_node for each in topic.subscribers)
    problem = ""
    if len(topic.types) > 1:
        problem = f"conflicting types: {', '.join(ref.name for ref in topic.types)}"
    elif is_awaited and not topic.publishers and not traffic.is_published:
        problem = "silent: no publishers"
    elif topic.publishers:
        problem = traffic.silence
    is_unheard = not (topic.subscribers or traffic.is_subscribed)
    key = _key(VertexKind.TOPIC, topic.name)
    return Vertex(key, VertexKind.TOPIC, topic.name, url, traffic.rate, problem, is_unheard=is_unheard)


def _connect_topic(draft: _Draft, topic: Topic) -> None:
    own = _key(VertexKind.TOPIC, topic.name)
    if own not in draft.vertices:
        return
    rate = draft.vertices[own].rate
    deaf: dict[str, Mismatch] = {}
    for each in mismatches(topic.publishers, topic.subscribers, _MAX_MISMATCHES):
        deaf.setdefault(each.subscriber, each)
    for endpoint in topic.publishers:
        draft.connect(_key(VertexKind.NODE, endpoint.node), own, rate, endpoint.unreachable or "")
    for endpoint in topic.subscribers:
        words = endpoint.unreachable or ""
        if (one := deaf.get(endpoint.node)) is not None:
            is_known = _key(VertexKind.NODE, one.publisher) in draft.vertices
            publisher = one.publisher if is_known else "a publisher"
            words = (
                f"receives nothing from {publisher}: {one.policy} {one.offered} is offered, {one.requested} requested"
            )
        draft.connect(own, _key(VertexKind.NODE, endpoint.node), rate, words)


def _select(whole: Diagram, below: str) -> Diagram:
    """Return the things below a name, and their neighbours: topics of nodes, and nodes of topics."""
    prefix = below.rstrip("/")
    inside = {each.key for each in whole.vertices if each.name == prefix or each.name.startswith(f"{prefix}/")}
    selected = inside | {
        other
        for edge in whole.edges
        for own, other in ((edge.source, edge.target), (edge.target, edge.source))
        if own in inside
    }
    edges = tuple(each for each in whole.edges if {each.source, each.target} & inside)
    vertices = tuple(each for each in whole.vertices if each.key in selected)
    return Diagram(vertices, edges, len(vertices))


def namespaces_of(diagram: Diagram) -> tuple[str, ...]:
    """Return the first segments that several names in a diagram share, for selection."""
    counts: dict[str, int] = {}
    for each in diagram.vertices:
        first = _prefix(each.name, 1)
        counts[first] = counts.get(first, 0) + each.count
    return tuple(sorted(name for name, count in counts.items() if count > 1))


def _prefix(name: str, depth: int) -> str:
    """Return the first segments of a name: `/a/b` for `/a/b/c`."""
    return "/" + "/".join(name.strip("/").split("/")[:depth])


def common_prefix(found: Iterable[str]) -> str:
    """Return the longest namespace common to all names, or `/`."""
    parts = [name.strip("/").split("/")[:-1] for name in found]
    shared: list[str] = []
    for segments in zip(*parts, strict=False):
        if len(set(segments)) > 1:
            break
        shared.append(segments[0])
    return "/" + "/".join(shared)


MAX_VERTICES = 70
"""Maximum number of vertices that a person can survey."""
EDGES_PER_VERTEX = 2
_DEEPEST = 4


def fold(diagram: Diagram, graph_url: str, limit: int = MAX_VERTICES) -> Diagram:
    """Return the diagram folded to at most `limit` vertices and `EDGES_PER_VERTEX` times as many edges, if possible.

    Things with the same neighbours are folded first, then things in one namespace, the deepest first, and nodes last.
    """
    found = diagram
    for grouping in _STAGES:
        if len(found.vertices) <= limit and len(found.edges) <= limit * EDGES_PER_VERTEX:
            return found
        found = _merge(found, grouping(found), graph_url)
    return found


Grouping = Callable[[Diagram], Callable[[Vertex], Hashable]]
"""A function of a diagram that returns a function from a vertex to its group (None: it is not folded)."""


def _by_neighbours(depth: int) -> Grouping:
    """Group things with the same neighbours and the same state, within namespaces of this depth."""

    def of_diagram(diagram: Diagram) -> Callable[[Vertex], Hashable]:
        before, after = defaultdict[str, set[str]](set), defaultdict[str, set[str]](set)
        for edge in diagram.edges:
            before[edge.target].add(edge.source)
            after[edge.source].add(edge.target)

        def key_of(vertex: Vertex) -> Hashable:
            if vertex.kind is VertexKind.NODE:
                return None
            ends = frozenset(before[vertex.key]), frozenset(after[vertex.key])
            return vertex.kind, bool(vertex.problem), vertex.is_unheard, _namespace(vertex)[:depth], *ends

        return key_of

    return of_diagram


def _by_namespace(depth: int, *, nodes: bool) -> Grouping:
    def key_of(vertex: Vertex) -> Hashable:
        return (vertex.kind, _namespace(vertex)[:depth]) if (vertex.kind is VertexKind.NODE) is nodes else None

    return lambda _: key_of


def _namespace(vertex: Vertex) -> tuple[str, ...]:
    """Return the segments of a name except the last; all segments of a folded vertex, whose name ends in a slash."""
    return tuple(filter(None, vertex.name.rpartition("/")[0].split("/")))


_STAGES: Sequence[Grouping] = (
    _by_neighbours(1),
    *(_by_namespace(depth, nodes=False) for depth in range(_DEEPEST, 0, -1)),
    *(_by_namespace(depth, nodes=True) for depth in range(_DEEPEST, 0, -1)),
    _by_neighbours(0),
    _by_namespace(0, nodes=False),
    _by_namespace(0, nodes=True),
)


def _merge(diagram: Diagram, key_of: Callable[[Vertex], Hashable], graph_url: str) -> Diagram:
    groups = defaultdict[Hashable, list[Vertex]](list)
    for vertex in diagram.vertices:
        key = key_of(vertex)
        groups[vertex.key if key is None else key].append(vertex)
    vertices = tuple(group[0] if len(group) == 1 else _folded_vertex(group, graph_url) for group in groups.values())
    place = {old.key: new.key for group, new in zip(groups.values(), vertices, strict=True) for old in group}
    edges: dict[tuple[str, str], Edge] = {}
    for edge in diagram.edges:
        ends = place[edge.source], place[edge.target]
        if ends[0] == ends[1]:
            continue
        known = edges.get(ends)
        edges[ends] = (
            replace(edge, source=ends[0], target=ends[1])
            if known is None
            else replace(known, rate=known.rate + edge.rate, problem=known.problem or edge.problem)
        )
    return Diagram(vertices, tuple(edges.values()), diagram.total)


def _folded_vertex(group: Sequence[Vertex], graph_url: str) -> Vertex:
    first, count = group[0], sum(each.count for each in group)
    within = common_prefix(each.name for each in group)
    wrong = [each for each in group if each.problem]
    problem = f"{len(wrong)} of {len(group)}: {wrong[0].problem}" if 0 < len(wrong) < len(group) else ""
    if len(wrong) == len(group):
        problem = wrong[0].problem
    return Vertex(
        f"{first.key} and {count - 1} more",
        first.kind,
        f"{within.rstrip('/')}/",
        f"{graph_url}?below={quote(within, safe='/')}" if within != "/" else first.url,
        sum(each.rate for each in group),
        problem,
        count,
        all(each.is_unheard for each in group),
    )
