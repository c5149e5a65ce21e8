"""Diagrams: connections, problems, folding, and that nothing overlaps."""

from __future__ import annotations

import random
from collections.abc import Iterable
from xml.etree import ElementTree

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rosld.adapters.model import Action, Endpoint, Graph, Node, Service, Topic, TypeRef
from rosld.adapters.model.qos import Qos
from rosld.ontology.urls import Space
from rosld.server.diagrams.diagram import MAX_VERTICES, Diagram, Selection, Traffic, VertexKind, draw_graph, fold
from rosld.server.diagrams.layout import Size, lay_out
from rosld.server.diagrams.svg import write_svg

SPACE = Space("http://robot/")
IMAGE = (TypeRef("sensor_msgs/msg/Image"),)


def topic(name: str, publishers: Iterable[str] = (), subscribers: Iterable[str] = (), **more: Qos) -> Topic:
    offered, requested = more.get("offered"), more.get("requested")
    return Topic(
        name,
        IMAGE,
        tuple(Endpoint(node, qos=offered) for node in publishers),
        tuple(Endpoint(node, qos=requested) for node in subscribers),
    )


def graph(*topics: Topic, services: Iterable[Service] = (), actions: Iterable[Action] = ()) -> Graph:
    nodes = {end.node for each in topics for end in (*each.publishers, *each.subscribers)}
    nodes |= {node for each in services for node in each.providers}
    nodes |= {node for each in actions for node in (*each.servers, *each.clients)}
    return Graph(
        1,
        nodes={name: Node(name) for name in nodes},
        topics={each.name: each for each in topics},
        services={each.name: each for each in services},
        actions={each.name: each for each in actions},
    )


def drawn(found: Graph, below: str = "", *, everything: bool = False, hidden: str = "?") -> Diagram:
    return draw_graph(found, SPACE, Selection(below, everything), lambda _: Traffic(), lambda url: hidden not in url)


def problems(diagram: Diagram) -> dict[str, str]:
    return {each.key: each.problem for each in diagram.vertices if each.problem} | {
        f"{each.source} -> {each.target}": each.problem for each in diagram.edges if each.problem
    }


ROBOT = graph(
    topic("/scan", ["/laser"], ["/map", "/nav"]),
    topic("/lonely", ["/laser"]),
    topic("/wished", [], ["/nav"]),
    topic("/rosout", ["/laser", "/map", "/nav"], ["/log"]),
    topic("/camera/image", ["/camera"], ["/nav"],
          offered=Qos(reliability="best_effort"), requested=Qos(reliability="reliable")),
    services=[Service("/map/save", None, ("/map",)), Service("/map/get_parameters", None, ("/map",))],
    actions=[Action("/go", TypeRef("x/action/Go"), ("/nav",), ("/boss",))],
)  # fmt: skip


def test_the_topics_of_an_action_of_ros_1_are_drawn_as_the_action_alone() -> None:
    inner = [topic(f"/dock/{part}", [], ["/nav"]) for part in ("goal", "cancel")]
    inner += [topic(f"/dock/{part}", ["/nav"], []) for part in ("status", "feedback", "result")]
    docking = Action("/dock", TypeRef("x/action/Dock"), ("/nav",), ())
    assert {each.key for each in drawn(graph(*inner, actions=[docking])).vertices} == {"node /nav", "action /dock"}
    service = Service("/dock/cancel", None, ("/nav",))
    assert "service /dock/cancel" in {each.key for each in drawn(graph(*inner, services=[service])).vertices}
    assert "topic /dock/goal" in problems(drawn(graph(*inner[:4], actions=[docking]))), "four of them are no action"


def large(count: int, spread: int) -> Graph:
    """Return a robot with this number of topics in namespaces, each with endpoints of some of many nodes."""
    choose = random.Random(7)
    nodes = [f"/area_{number % 9}/node_{number}" for number in range(60)]
    return graph(
        *(
            topic(f"/area_{number % spread}/part_{number % 17}/topic_{number}", choose.sample(nodes, 1),
                  choose.sample(nodes, choose.choice([0, 1, 1, 2])))
            for number in range(count)
        )
    )  # fmt: skip


@pytest.mark.parametrize(("count", "spread"), [(300, 300), (1000, 30)])
def test_three_hundred_topics_are_folded_to_what_can_be_read(count: int, spread: int) -> None:
    whole = drawn(large(count, spread))
    found = fold(whole, "http://robot/graph")
    assert len(found.vertices) <= MAX_VERTICES
    assert sum(each.count for each in found.vertices) == len(whole.vertices) == found.total
    assert {each.kind for each in found.vertices} == {VertexKind.NODE, VertexKind.TOPIC}
    folded = [each for each in found.vertices if each.count > 1]
    assert folded
    assert len(found.edges) <= 2 * MAX_VERTICES
    assert all(each.url.startswith(("http://robot/graph?below=/area_", "http://robot/topics/")) for each in folded)
    kinds = {each.key: each.kind for each in found.vertices}
    assert all(kinds[each.source] is not kinds[each.target] for each in found.edges)


def test_a_small_graph_is_not_folded() -> None:
    assert fold(drawn(ROBOT), "http://robot/graph") == drawn(ROBOT)


def test_three_hundred_topics_are_drawn_on_one_page() -> None:
    def arms(subscribers: list[str]) -> Graph:
        return graph(*(topic(f"/arm_{n % 65}/{n}", [f"/arm_{n % 65}/driver"], subscribers) for n in range(325)))

    flat = (topic(f"/topic_{n}", [f"/node_{n % 60}"], [f"/node_{n * 7 % 60}"]) for n in range(325))
    for robot in (arms(["/logger"]), arms([]), graph(*flat), large(325, 5)):
        text = write_svg(fold(drawn(robot), "http://robot/graph"), lambda url: url, "robot", alone=True)
        width, height = (float(ElementTree.fromstring(text).get(side, "")) for side in ("width", "height"))
        assert height <= 1000
        assert 300 < width < 1400


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 25), st.lists(st.tuples(st.integers(0, 24), st.integers(0, 24)), max_size=60))
def test_no_box_stands_on_another_and_every_edge_joins_its_boxes(count: int, pairs: list[tuple[int, int]]) -> None:
    sizes = {f"v{number}": Size(40 + number * 3, 30) for number in range(count)}
    joined = [(f"v{one}", f"v{other}") for one, other in pairs if one < count and other < count]
    layout = lay_out(sizes, joined)
    assert layout.corners.keys() == sizes.keys()
    boxes = [(*layout.corners[key], *sizes[key]) for key in sizes]
    for index, (x, y, width, height) in enumerate(boxes):
        assert x >= 0
        assert y >= 0
        assert x + width <= layout.size.width
        assert y + height <= layout.size.height
        for x2, y2, width2, height2 in boxes[:index]:
            apart = x + width <= x2 or x2 + width2 <= x or y + height <= y2 + 1e-6 or y2 + height2 <= y + 1e-6
            assert apart
    for one, other in {pair for pair in joined if pair[0] != pair[1]}:
        for key, point in ((one, layout.routes[one, other][0]), (other, layout.routes[one, other][-1])):
            corner, size = layout.corners[key], sizes[key]
            assert point.x in (corner.x, corner.x + size.width)
            assert abs(point.y - corner.y - size.height / 2) < 1e-6


def test_a_drawing_is_xml_whatever_the_names_hold() -> None:
    name = "/<script>alert('&\"')</script>\x07\u202e"
    found = drawn(graph(topic(name, ["/a\x00]]>"], ["/b"])))
    text = write_svg(found, lambda url: url, "<robot>", alone=True)
    root = ElementTree.fromstring(text)
    tags = {each.tag.rpartition("}")[2] for each in root.iter()}
    assert tags == {"svg", "title", "style", "g", "path", "rect", "text", "a"}
    assert "<script" not in text
    links = [each.get("href") for each in root.iter() if each.tag.endswith("}a")]
    assert len(links) == 3
    assert all(str(each).startswith("http://robot/") for each in links)
