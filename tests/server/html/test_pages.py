"""Content of pages: the description, messages, members, notices, results, and the operations on offer."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.document import Document
from rosld.ontology.vocab import ldp, rdf, ros, xsd
from rosld.server.html.messages import message_view
from rosld.server.html.page import Page, PageResults, SparqlPage, Term
from rosld.server.html.render import render_page, render_sparql
from rosld.server.html.site import Site
from rosld.server.html.view import (
    ArrayView,
    TableListView,
    TableView,
    TextView,
    TimeView,
    View,
    duration_view,
    time_view,
    time_view_of_text,
)
from tests.server.html.messages import BASE, lifted, message, schema

SITE = Site(BASE, "robot")
URL = f"{BASE}topics/x"


def drawn(*triples: Triple) -> str:
    return render_page(Page(SITE, "Topic", "/x", Document(URL, triples))).decode()


def field(view: TableView, *path: str) -> View:
    """Return the value of a field in a message's table."""
    found: View = view
    for name in path:
        assert isinstance(found, TableView)
        found = next(row.values[0] for row in found.rows if row.label == name)
    return found


def test_times_are_readable_and_exact() -> None:
    found = time_view(1_795_225_901_123_456_789)
    assert found == TimeView("2026-11-21T01:51:41.123456789Z", "2026-11-21 01:51:41.123 UTC")
    assert time_view_of_text("2026-11-21T01:51:41.5Z") == TimeView(
        "2026-11-21T01:51:41.5Z", "2026-11-21 01:51:41.500 UTC"
    )
    assert time_view_of_text("-0004-01-01T00:00:00Z") == TextView("-0004-01-01T00:00:00Z")
    assert duration_view(-1, 500_000_000) == TextView("-0.5 s")


@given(st.integers(-(2**70), 2**70))
def test_no_time_is_too_strange_to_be_shown(nanoseconds: int) -> None:
    assert isinstance(time_view(nanoseconds), TimeView | TextView)


def test_a_message_is_a_table_of_its_fields() -> None:
    kind = schema("nav_msgs/msg/Odometry")
    value = {"header": {"stamp": {"sec": 5}}, "pose": {"pose": {"position": {"x": 0.1}}, "covariance": [0.5] * 36}}
    shown = message(kind, value)
    view = message_view(kind, shown)
    assert field(view, "pose", "pose", "position", "x") == TextView("0.1", tone="number", unit="m")
    assert field(view, "twist", "twist", "angular", "z").unit == "rad/s"
    assert isinstance(field(view, "header", "stamp"), TimeView)
    assert isinstance(field(message_view(kind, shown, simulated_time=True), "header", "stamp"), TextView)
    covariance = field(view, "pose", "covariance")
    assert isinstance(covariance, ArrayView)
    assert (covariance.count, covariance.head.count(",")) == (36, 7)


def test_levels_of_diagnostics_have_words() -> None:
    kind = schema("diagnostic_msgs/msg/DiagnosticArray")
    views = (
        TextView("OK", "0", tone="good"),
        TextView("WARN", "1", tone="warning"),
        TextView("ERROR", "2", tone="error"),
        TextView("STALE", "3", tone="warning"),
        TextView("7", tone="number"),
    )
    levels = [{"level": level, "name": "motor"} for level in (0, 1, 2, 3, 7)]
    status = field(message_view(kind, message(kind, {"status": levels})), "status")
    assert isinstance(status, TableListView)
    assert tuple(field(item, "level") for item in status.items) == views


@pytest.mark.slow
def test_a_huge_message_is_cut_visibly() -> None:
    kind = schema("diagnostic_msgs/msg/DiagnosticArray")
    many = {"status": [{"values": [{"key": str(n), "value": "v"} for n in range(200)]} for _ in range(200)]}
    body = render_page(Page(SITE, "Topic", "/x", Document(URL, (), (lifted("#message", kind, many),)))).decode()
    assert len(body) < 1_500_000
    assert re.search(r"\d+ more in the other formats", body)


def test_a_long_array_is_cut_visibly() -> None:
    kind = schema("std_msgs/msg/Float64MultiArray")
    view = field(message_view(kind, message(kind, {"data": [float(number) for number in range(5000)]})), "data")
    assert isinstance(view, ArrayView)
    assert view.full is not None
    assert view.full.endswith("1999.0 …")


@pytest.mark.slow
def test_latest_messages_of_several_publishers_have_sections_of_their_own(pages: Mapping[str, bytes]) -> None:
    body = pages["odometry"].decode()
    places = [body.index(f'id="{name}"') for name in ("by-publisher", "from/rosld", "message", "section-own")]
    assert places == sorted(places)
    assert "Latest from /robot" in body
    assert "Latest from /rosld" in body


@pytest.mark.slow
def test_what_is_wrong_with_a_resource_comes_first(pages: Mapping[str, bytes]) -> None:
    here = NamedNode(URL)
    wrong = Triple(here, ros.unreachable, Literal("the publisher /camera does not answer"))
    kind = schema("std_msgs/msg/String")
    latest = Triple(here, ros.latest, NamedNode(f"{URL}#message"))
    document = Document(URL, (latest, wrong), (lifted("#message", kind, {}),))
    body = render_page(Page(SITE, "Topic", "/x", document)).decode()
    assert body.index("Unreachable: the publisher") < body.index("Latest message")
    assert "no answer since 01:31:41 UTC" in pages["stale"].decode()
    assert "Last known state" in pages["stale"].decode()


@pytest.mark.slow
def test_a_container_lists_members_with_their_columns_and_namespaces_apart(pages: Mapping[str, bytes]) -> None:
    body = pages["topics"].decode()
    name = '<span class="whole">front_<wbr>laser_<wbr>scan</span>'
    assert f'<a href="/topics/front_laser_scan"><bdi>{name}</bdi></a>' in body
    assert re.search(r'<li data-key="/topics/turtle1/"><a href="/topics/turtle1/"><bdi>turtle1/</bdi></a></li>', body)
    assert '<a class="below" href="/topics/camera/image_raw/">' in pages["camera"].decode()
    assert 'href="/types/sensor_msgs/msg/LaserScan"' in body


def test_a_container_takes_its_columns_from_its_own_description() -> None:
    container, member = NamedNode(URL + "/"), NamedNode(f"{URL}/a")
    triples = (
        Triple(container, ldp.contains, member),
        Triple(member, rdf.type, ros.Topic),
        Triple(member, ros.rate, Literal("5.0", datatype=xsd.double)),
    )
    body = render_page(Page(SITE, "Container", "x", Document(URL + "/", triples))).decode()
    assert re.search(r'<th scope="col">rate</th>', body)
    assert body.count("5.0") == 1


def test_lists_blank_nodes_and_fragments_are_drawn_in_place() -> None:
    here, part, cell, inner = NamedNode(URL), NamedNode(f"{URL}#part"), BlankNode(), BlankNode()
    body = drawn(
        Triple(here, ros.hasQosMismatch, part),
        Triple(part, ros.latched, Literal(True)),
        Triple(here, ros.hasField, cell),
        Triple(cell, rdf.first, inner),
        Triple(cell, rdf.rest, rdf.nil),
        Triple(inner, ros.name, Literal("within")),
    )
    assert body.count("<h2") == 1
    assert 'id="part"' in body
    assert "within" in body


IRIS = st.sampled_from([URL, f"{URL}#a", f"{URL}#b", f"{BASE}nodes/n", "javascript:x", "https://w3id.org/rosld#Topic"])
SUBJECTS = IRIS.map(NamedNode) | st.sampled_from([BlankNode("a"), BlankNode("b")])
OBJECTS = SUBJECTS | st.text(st.characters(exclude_categories=["Cs"])).map(Literal)
PREDICATES = st.sampled_from([rdf.type, rdf.first, rdf.rest, ros.name, ros.latest, ldp.contains, NamedNode("x:y")])


@settings(max_examples=50)
@given(st.lists(st.builds(Triple, SUBJECTS, PREDICATES, OBJECTS), max_size=12))
def test_any_description_can_be_drawn(triples: list[Triple]) -> None:
    assert "</html>" in drawn(*triples)


def rows(count: int, taken: list[int]) -> Iterator[Sequence[Term | None]]:
    for number in range(count):
        taken.append(number)
        yield (Literal(number), None, BlankNode("b"), NamedNode(URL))


def test_large_results_are_cut_and_not_read_further() -> None:
    taken: list[int] = []
    results = PageResults(("a", "b", "c", "d"), rows(10_000, taken), limit=50)
    body = render_sparql(SparqlPage(SITE, "SELECT", results=results)).decode()
    assert len(taken) == 51
    assert "Only the first 50 rows" in body
    assert body.count('<a href="/topics/x"') == 50


def test_commands_to_copy_are_safe_to_paste() -> None:
    url = f"{BASE}topics/';rm%20-rf%20~;'"
    body = render_page(Page(SITE, "Topic", "/x", Document(url, ()))).decode()
    command = body[body.index("curl -H") :].split("</code>")[0].replace("&#39;", "'")
    assert command == f"curl -H 'Accept: text/turtle' '{BASE}topics/%27;rm%20-rf%20~;%27'"


# What a resource offers

FORM = re.compile(r"<form.*?</form>", re.DOTALL)


def forms(body: str) -> dict[tuple[str, str], str]:
    """Return the forms of a page by target (empty for the page's own URL) and method."""
    found = {}
    for form in FORM.findall(below_header(body)):
        action = re.search(r'action="([^"]*)"', form)
        method = re.search(r'name="method" value="([^"]*)"', form)
        assert method is not None
        found[(action[1] if action else "", method[1])] = form
    return found


def below_header(body: str) -> str:
    """Return the page without the header of every page: the search, and the stop."""
    return body.partition("<main")[2]


@pytest.mark.slow
def test_values_have_their_units_and_limits(pages: Mapping[str, bytes]) -> None:
    wing, body = pages["wing"].decode(), pages["engine"].decode()
    assert re.search(r'5</bdi>\s*<a class="unit" href="http://qudt.org/vocab/unit/REV-PER-MIN"', wing)
    speed = forms(body)[("/resources/aircraft/engine/speed", "PUT")]
    assert 'min="0" max="1000" step="any"' in speed
    assert "From 0 to 1000." in speed
    direction = forms(body)[("/resources/aircraft/engine/direction", "PUT")]
    assert "From 0 to 360." in direction


@pytest.mark.slow
def test_a_choice_is_a_select_in_which_a_value_that_is_no_choice_is_never_chosen(pages: Mapping[str, bytes]) -> None:
    (form,) = forms(pages["select"].decode()).values()
    assert re.findall(r"<option([^>]*)>([^<]*)", form) == [("", "on"), (" selected", "off")]
    form = forms(pages["unmapped"].decode())[("/resources/turtle1/gear", "PUT")]
    assert re.findall(r"<option([^>]*)>", form) == [' value="" selected', "", ""]
    assert "<select" in form
    assert " required" in form


@pytest.mark.slow
def test_what_cannot_be_read_says_why_and_only_single_scalars_are_set_in_place(pages: Mapping[str, bytes]) -> None:
    body = pages["unmapped"].decode()
    for source in ("get_battery", "distance"):
        assert re.search(rf'cannot be read</span> <bdi class="why">/turtle1/{source} did not respond', body)
    assert "can only be written" in body
    assert "Leonardo" in body
    posted = forms(body)
    assert {action for action, method in posted if method == "PUT"} == {
        f"/resources/turtle1/{name}" for name in ("gear", "lamp")
    }
    changed = re.findall(r'<a href="([^"]+)">Change<', body)
    assert changed == [f"/resources/turtle1/{name}" for name in ("awake", "limits", "name", "pen")]
    assert ("/resources/turtle1/dance", "POST") not in posted, "its type is unknown"
    assert 'href="/resources/turtle1/dance"' in body


@pytest.mark.slow
def test_a_resource_links_what_is_behind_it_and_folds_its_rdf(pages: Mapping[str, bytes]) -> None:
    number, engine = pages["number"].decode(), pages["engine"].decode()
    behind = number[number.index("In ROS") :]
    assert re.search(r'href="/topics/aircraft/engine/speed".*?topic', behind, re.DOTALL)
    assert 'href="/services/aircraft/engine/set_speed"' in behind
    body = pages["aircraft_started"].decode()
    before, folded = body.split('<details class="folded">')
    assert "action affordance" in folded
    assert "affordance" not in before
    assert "<details open" not in body
    assert ('href="?format=td"' in engine, 'href="?format=td"' in number) == (True, False)
