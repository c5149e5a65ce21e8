"""`/find`: search by words, in RDF, JSON and HTML, on the rover and on a robot with hundreds of topics."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest
from pyoxigraph import Literal, NamedNode

from rosld.adapters.model import Descriptor
from rosld.ontology.vocab import hydra, ros, schema_org
from rosld.server.resources.find import MAX_BYTES, MAX_RESULTS
from tests.server.conftest import Served
from tests.server.robots.asking import JSON, TURTLE, XSD, detail, mapped, triples, value
from tests.server.robots.made_up import MadeUp, Serving, served
from tests.server.robots.many import furnish

pytestmark = pytest.mark.slow

HTML = {"Accept": "text/html"}
RDF = {"Accept": "text/turtle"}


def find(http: httpx.Client, query: str) -> list[dict[str, Any]]:
    """Return the results of a search in plain JSON."""
    results: list[dict[str, Any]] = found(http, query)["results"]
    return results


def found(http: httpx.Client, query: str) -> dict[str, Any]:
    answer = http.get("/find", params={"q": query}, headers=JSON)
    assert answer.status_code == 200, answer.text
    assert len(answer.content) <= MAX_BYTES
    told: dict[str, Any] = answer.json()
    return told


def names(results: list[dict[str, Any]]) -> list[str]:
    return [result["name"] for result in results]


@pytest.fixture(scope="module")
def many() -> Iterator[httpx.Client]:
    """A robot with 330 topics."""
    robot = MadeUp()
    furnish(robot)
    with served(robot) as client:
        yield client


def test_a_program_that_knows_only_the_entry_finds_the_battery_of_an_unmapped_robot(
    serve: Callable[..., Served],
) -> None:
    http = serve("rover").http
    links = httpx.Response(200, headers=http.get("/", headers=JSON).headers).links
    [template] = [
        triple.object.value
        for triple in triples(http.get("/", headers=RDF))
        if triple.predicate == hydra.template and isinstance(triple.object, Literal)
    ]
    assert template == f"{links['search']['url']}{{?q}}"
    assert '<form class="find" role="search" method="get" action="/find"' in http.get("/nothing", headers=HTML).text
    first = find(http, "battery")[0]
    assert (first["name"], first["kind"], first["type"]) == ("/battery_state", "topic", "sensor_msgs/msg/BatteryState")
    assert 0 < value(http, first["url"])["percentage"] <= 1
    again = find(http, "battery")[0]
    assert 0 < again["value"]["percentage"] <= 1, "what was read is at hand now"
    assert value(http, again["resource"])["percentage"] <= again["value"]["percentage"]
    told = http.get("/find", params={"q": "sensor_msgs", "values": "true"}, headers=JSON).json()["results"]
    values = {result["name"]: result.get("value") for result in told if result["kind"] == "topic"}
    assert "voltage" in values["/battery_state"]
    assert {"/camera/image_raw", "/camera/image_raw/compressed", "/scan"} <= values.keys()
    assert not any(values[name] for name in values if "image" in name or name == "/scan"), "large messages"
    assert http.get("/find", params={"q": "battery", "values": "perhaps"}, headers=JSON).status_code == 400


def test_results_say_what_they_are_and_by_what_they_were_found(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/power/battery", "sensor_msgs/msg/BatteryState", {"percentage": 0.5})
    robot.topic("/odom", "nav_msgs/msg/Odometry")
    robot.variable("/lights/level", "Byte", value=3)
    robot.offer("/battery/reset", "std_srvs/srv/Trigger", lambda _: {"success": True})
    robot.parameter("/robot/low_battery", 0.25)
    http = serving()
    http.get("/topics/power/battery")
    http.get("/resources/lights/level")
    base = str(http.base_url)
    results = {(one["kind"], one["name"]): one for one in find(http, "battery")}
    assert list(results) == [
        ("topic", "/power/battery"),
        ("resource", "/battery/"),
        ("service", "/battery/reset"),
        ("parameter", "/robot/low_battery"),
        ("resource", "/power/"),
    ]
    topic = results["topic", "/power/battery"]
    assert topic["value"]["percentage"] == 0.5
    assert topic["resource"] == f"{base}resources/power/battery"
    assert results["parameter", "/robot/low_battery"]["value"] == 0.25
    assert results["service", "/battery/reset"]["resource"] == f"{base}resources/battery/reset"
    odom = find(http, "position")[0]
    assert (odom["match"], odom["field"]) == ("field", "pose.pose.position")
    level = find(http, "level")
    assert (level[0]["kind"], level[0]["url"]) == ("resource", f"{base}resources/lights/level")
    assert level[0]["value"] == {"value": 3}


def test_what_mappings_and_descriptors_say_is_found(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/a/b", "std_msgs/msg/Float64", {"data": 1.0})
    robot.parameter("/n/p", 1)
    robot.declared["/n/p"] = Descriptor(description="How hard the gripper closes")
    http = serving()
    mapped(
        http,
        """
        <> a map:ComplexResource ; rdfs:label "The propulsion" ; map:path "/a/" ; map:property [
            map:predicate ex:thrust ; map:member "/a/b" ; qudt:hasUnit unit:KiloN ;
            qudt:hasQuantityKind quantitykind:Force ] .
        """.replace("rdfs:label", "<http://www.w3.org/2000/01/rdf-schema#label>"),
    )
    assert [one["url"] for one in find(http, "propulsion")] == [
        f"{http.base_url}resources/a/",
        f"{http.base_url}mappings/mine",
    ]
    for word in ("thrust", "kilo", "force"):
        assert names(find(http, word)) == ["/a/b"], word
    assert names(find(http, "gripper closes")) == ["/n/p"]


def test_queries_and_documents_are_found_by_title_and_new_names_at_once(robot: MadeUp, serving: Serving) -> None:
    http = serving()
    body = '<> <http://purl.org/dc/terms/title> "The docking station in the hall" .'
    assert http.put("/data/places/station", content=body, headers=TURTLE).status_code == 201
    [place] = find(http, "docking hall")
    assert (place["kind"], place["url"]) == ("document", f"{http.base_url}data/places/station")
    assert "name" not in place
    assert find(http, "what can be done")[0]["url"] == f"{http.base_url}queries/what-can-be-done"
    http.delete("/data/places/station")
    assert find(http, "docking hall") == []
    assert find(http, "emergency")[0]["url"] == f"{http.base_url}stop"
    assert find(http, "gripper") == []
    robot.topic("/gripper", "std_msgs/msg/Float64")
    assert names(find(http, "gripper")) == ["/gripper"]


def test_a_question_that_nothing_answers_whole_finds_what_has_most_of_its_words(
    robot: MadeUp, serving: Serving
) -> None:
    robot.topic("/juice", "sensor_msgs/msg/BatteryState")
    robot.topic("/front/door", "std_msgs/msg/Float64")
    http = serving()
    told = found(http, "How much battery is there behind the front door?")
    assert (told["matched"], names(told["results"][:3])) == ("some", ["/front/door", "/juice", "/front/"])
    assert (told["results"][1]["match"], "offer" in told["results"][1]) == ("meaning", False)
    told = found(http, "batery")
    assert (told["matched"], names(told["results"])) == ("all", ["/juice"])
    assert "some of the words" in http.get("/find?q=battery+door", headers=RDF).text
    assert "some of the words" not in http.get("/find?q=door", headers=RDF).text


def test_what_does_comes_before_what_tells_if_the_question_commands_and_says_where_its_offer_is(
    robot: MadeUp, serving: Serving
) -> None:
    robot.topic("/a", "nav_msgs/msg/Odometry")
    robot.topic("/z/soll", "geometry_msgs/msg/Twist", published=False, heard=True)
    robot.offer("/z/get_loggers", "std_srvs/srv/Trigger", lambda _: {"success": True})
    http = serving()
    assert names(find(http, "drive")) == ["/z/soll", "/a"]
    assert names(find(http, "how fast does it drive")[:2]) == ["/a", "/z/soll"]
    offered = {one["name"]: one.get("offer") for one in find(http, "drive")}
    assert offered == {"/z/soll": f"{http.base_url}topics/z/soll?offer", "/a": None}
    assert names(find(http, "z"))[-1] == "/z/get_loggers", "what every node has comes last"


def test_if_nothing_is_found_the_answer_says_what_there_is(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/juice", "sensor_msgs/msg/BatteryState")
    robot.topic("/soll", "geometry_msgs/msg/Twist", published=False, heard=True)
    http = serving()
    told = found(http, "xylophone")
    base = http.base_url
    about = {each["concept"]: each["url"] for each in told["about"]}
    assert (told["results"], about["battery"], about["drive"]) == ([], f"{base}topics/juice", f"{base}topics/soll")
    assert len(json.dumps(told["about"])) <= 1000
    assert "about" not in found(http, "juice")
    said = {(each.subject, each.predicate, each.object) for each in triples(http.get("/find?q=xylophone", headers=RDF))}
    for concept, url in about.items():
        assert (NamedNode(f"{base}find?q=xylophone"), schema_org.about, NamedNode(url)) in said
        assert (NamedNode(url), schema_org.keywords, Literal(concept)) in said
    assert re.search(
        r"<dt>battery</dt>\s*<dd><a href=\"/topics/juice\"", http.get("/find?q=xylophone", headers=HTML).text
    )


def test_a_search_subscribes_to_nothing(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/battery", "sensor_msgs/msg/BatteryState", {})
    robot.variable("/lights/level", "Byte", value=3)
    http = serving()
    assert "value" not in find(http, "battery")[0]
    assert find(http, "level")
    assert (robot.subscribed(), robot.calls) == (set(), {})


def test_hundreds_of_topics_are_told_by_the_best_twenty_in_five_kilobytes(many: httpx.Client) -> None:
    told = found(many, "image")
    assert (told["total"], len(told["results"])) == (16 + 8 + 8 * 3, MAX_RESULTS), "whatever cameras have, last"
    assert names(told["results"][:8]) == [f"/camera_{number}/image_raw" for number in range(1, 9)]
    assert names(find(many, "battery_3 state"))[0] == "/battery_3/state"
    assert names(find(many, "wheel_7")) == ["/wheel_7/", "/wheel_7/odom", "/wheel_7/current", "/wheel_7/velocity"]
    first = many.get("/find?q=odom", headers=JSON)
    assert many.get("/find?q=odom", headers={**JSON, "If-None-Match": first.headers["etag"]}).status_code == 304


def test_values_are_left_out_before_results(robot: MadeUp, serving: Serving) -> None:
    for number in range(30):
        name = f"/{'very_' * 6}long_name_of_a_battery_{number:02}"
        robot.topic(name, "sensor_msgs/msg/BatteryState", {"percentage": 0.5})
    http = serving(subscribe=("/*",))
    results = find(http, "battery")
    assert "value" in results[0]
    assert "value" not in results[-1]
    assert len(results) >= 14


def test_rdf_json_and_the_page_say_the_same_in_the_same_order(many: httpx.Client) -> None:
    results = find(many, "odom")
    answer = many.get("/find?q=odom", headers=RDF)
    said = {(triple.subject, triple.predicate): triple.object for triple in triples(answer)}
    base = str(answer.url)
    items = [said[NamedNode(f"{base}#{number}"), schema_org.item] for number in range(1, len(results) + 1)]
    assert [one["url"] for one in results] == [getattr(item, "value", None) for item in items]
    assert said[NamedNode(base), schema_org.numberOfItems] == Literal(
        str(len(results)), datatype=NamedNode(f"{XSD}integer")
    )
    first = NamedNode(results[0]["url"])
    assert said[first, ros.name] == Literal(results[0]["name"])
    assert said[first, ros.hasMessageType] == NamedNode(f"https://w3id.org/rosld/types/{results[0]['type']}")
    page = many.get("/find?q=odom", headers=HTML).text
    links = re.findall(r'<th scope="row">\s*<a href="([^"]+)"', page)
    assert links == [httpx.URL(one["url"]).path for one in results]
    assert 'name="q" value="odom"' in page


def test_whatever_is_searched_for_is_answered_unless_it_is_too_much(many: httpx.Client) -> None:
    for query, words in (("x" * 201, "201 characters"), (" ".join("bcdefghjk"), "9 words")):
        assert words in detail(many.get("/find", params={"q": query}), 400)
    for query in ("", " ", "xyzzy", "\u202e</script>", '"', "%00", "a/b?c#d&e=f"):
        assert found(many, query)["total"] == 0
        for accept in (RDF, HTML, {"Accept": "application/ld+json"}, {"Accept": "application/rdf+xml"}):
            answer = many.get("/find", params={"q": query}, headers=accept)
            assert answer.status_code == 200
            assert "</script></script>" not in answer.text
