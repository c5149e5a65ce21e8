"""Several robots in one server: each below its own URL, and the base about all of them."""

from __future__ import annotations

import asyncio
import random
import re
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import pytest
from pyoxigraph import NamedNode, RdfFormat, parse

from rosld.adapters.base import Adapter, AdapterOptions, Capabilities, Published
from rosld.adapters.embedded import EmbeddedRobot, Interface
from rosld.adapters.model import Encoding, TypeRef, Unreachable
from rosld.adapters.registry import adapter_for, joined, named_sources
from rosld.server.auth.tokens import generate_token, token_digest
from rosld.server.robots.robots import Robots
from rosld.server.serving.lifespan import lifespan
from rosld.server.settings import Settings
from tests.adapters.ros1.system import running
from tests.server.conftest import Served
from tests.server.dataset.conftest import Oxigraph

CONTAINS = NamedNode("http://www.w3.org/ns/ldp#contains")
JSON = {"accept": "application/json"}
CAPABILITIES = Capabilities("counter", Encoding.CDR, writes=True, creates_topics=False, parameter_trees=False)


class Counting(EmbeddedRobot):
    """A robot that keeps the numbers published to it."""

    def __init__(self, source: str, options: AdapterOptions) -> None:
        super().__init__(
            CAPABILITIES, options, published={}, subscribed={"/number": Interface("std_msgs/msg/Int64", node="/me")}
        )
        self.source = source
        self.received: Counter[bytes] = Counter()
        self.is_broken = False

    def _start(self) -> None:
        if self.is_broken:
            raise Unreachable("its plug is pulled")

    async def publish(
        self, topic: str, type: TypeRef, data: bytes, *, latch: bool = False, deadline: float
    ) -> Published:
        self.received[data[4:]] += 1
        return await super().publish(topic, type, data, latch=latch, deadline=deadline)


class Site:
    """Robots in this process, reached through their ASGI application."""

    def __init__(self, *names: str, **settings: Any) -> None:
        self.opened: dict[str, list[Counting]] = {}
        self.broken: set[str] = set()
        chosen = {"base_url": "http://127.0.0.1:8080/", "max_publish_rate": 1e6, "publish_wait": 60.0, **settings}
        base = Settings(**chosen)
        self.robots = Robots({name: f"counting:{name}" for name in names}, base, self._open)
        transport = httpx.ASGITransport(self.robots, client=("127.0.0.1", 1))
        self.http = httpx.AsyncClient(transport=transport, base_url=base.base_url)

    def _open(self, source: str, options: AdapterOptions) -> Adapter:
        if source.startswith("ros1:"):
            return adapter_for(source, options)
        made = Counting(source, options)
        name = source.removeprefix("counting:")
        made.is_broken = name in self.broken
        self.opened.setdefault(name, []).append(made)
        return made

    async def get(self, path: str) -> Any:
        """Return the JSON at a path."""
        answer = await self.http.get(path, headers=JSON)
        assert answer.status_code == 200, answer.text
        return answer.json()

    async def put(self, path: str, value: int) -> int:
        """Publish a number; return the status."""
        return (await self.http.put(path, json={"data": value})).status_code

    async def until(self, condition: Callable[[], bool]) -> None:
        """Wait for a condition on the robots."""
        changed = asyncio.Event()
        with closing(self.robots.changes.watch(changed.set)):
            while not condition():
                changed.clear()
                await asyncio.wait_for(changed.wait(), 20)


@pytest.mark.slow
async def test_each_of_many_random_writes_arrives_at_its_own_robot() -> None:
    site, chance = Site("one", "two"), random.Random(7)
    writes = [(chance.choice(["one", "two"]), chance.getrandbits(40)) for _ in range(600)]
    async with lifespan(site.robots):
        waiting = iter(writes)

        async def work() -> None:
            for name, value in waiting:
                assert await site.put(f"robots/{name}/topics/number", value) == 204
                await asyncio.sleep(0)

        await asyncio.gather(*(work() for _ in range(32)))
        for name in ("one", "two"):
            expected = Counter(value.to_bytes(8, "little") for robot, value in writes if robot == name)
            assert site.opened[name][-1].received == expected


@pytest.fixture(scope="module")
def site(start_server: Callable[..., Served]) -> httpx.Client:
    """A client of a rover and an aircraft side by side."""
    return start_server("rover=rover", "plane=aircraft", "--faults", "quiet").http


def ask(site: httpx.Client, path: str, query: str) -> list[list[str]]:
    """Return the rows of a query at an endpoint."""
    answer = site.post(path, data={"query": query}, headers={"accept": "application/sparql-results+json"})
    assert answer.status_code == 200, answer.text
    return [[term["value"] for term in row.values()] for row in answer.json()["results"]["bindings"]]


def test_the_container_of_robots_links_to_each_with_its_state(site: httpx.Client) -> None:
    assert [(each["name"], each["state"], each["source"]) for each in site.get("robots/", headers=JSON).json()] == [
        ("rover", "Live", "rover"),
        ("plane", "Live", "aircraft"),
    ]
    answer = site.get("robots/", headers={"accept": "text/turtle"})
    triples = [quad.triple for quad in parse(answer.content, RdfFormat.TURTLE, base_iri=str(answer.url))]
    members = {each.object.value for each in triples if each.predicate == CONTAINS}
    assert members == {f"{site.base_url}robots/rover/", f"{site.base_url}robots/plane/"}
    assert 'rel="service-desc"' in answer.headers["link"]
    assert "BasicContainer" in answer.headers["link"]
    unchanged = site.get("robots/", headers={"accept": "text/turtle", "if-none-match": answer.headers["etag"]})
    assert unchanged.status_code == 304
    assert 'route="/robots/"' in site.get("metrics").text
    assert site.get("").is_redirect
    assert site.get("").headers["location"] == f"{site.base_url}robots/"


def test_the_page_of_robots_has_a_button_to_stop_each_and_no_dead_link(site: httpx.Client) -> None:
    page = site.get("robots/", headers={"accept": "text/html"}).text
    for name in ("rover", "plane"):
        assert f'action="/robots/{name}/stop"' in page
        assert f'href="/robots/{name}/cockpit/default"' in page
    for link in re.findall(r'href="(/[^"]*)"', page):
        assert site.get(link, headers={"accept": "text/html"}).status_code < 400, link
    assert site.get("cockpit/default").headers["location"] == f"{site.base_url}robots/"


def test_each_robot_is_as_if_it_were_alone(site: httpx.Client) -> None:
    odometry = site.get("robots/rover/topics/odom", headers=JSON)
    assert odometry.status_code == 200
    assert site.get("robots/plane/topics/odom", headers=JSON).status_code == 404
    assert site.get("topics/odom").status_code == 404
    entry = site.get("robots/plane/", headers={"accept": "text/turtle"})
    assert "aircraft" in entry.text
    assert site.get("robots/plane").headers["location"] == f"{site.base_url}robots/plane/"
    assert site.get("robots/other/topics/").status_code == 404


@pytest.mark.slow
def test_one_query_matches_the_values_of_all_robots(site: httpx.Client) -> None:
    graphs = ask(site, "sparql", "SELECT ?g { ?g a ros:Graph }")
    assert sorted(graphs) == [[f"{site.base_url}robots/plane/"], [f"{site.base_url}robots/rover/"]]
    live = ask(site, "sparql", "SELECT ?l { GRAPH <robots/> { ?r rdfs:label ?l ; ros:state ros:Live } }")
    assert sorted(live) == [["plane"], ["rover"]]
    x = "SELECT ?x { GRAPH <robots/rover/topics/odom> { ?m ros:latest ?v . ?v ?field ?x } }"
    assert ask(site, "sparql", x)
    topics = {topic for (topic,) in ask(site, "sparql", "SELECT ?t { ?t a ros:Topic }")}
    own = {topic for (topic,) in ask(site, "robots/rover/sparql", "SELECT ?t { ?t a ros:Topic }")}
    assert own == {each for each in topics if "/robots/rover/" in each} != topics


def test_an_update_reaches_the_robot_that_it_names(site: httpx.Client) -> None:
    insert = "INSERT DATA { GRAPH <robots/rover/data/note> { <robots/rover/> rdfs:comment 'mine' } }"
    answer = site.post("sparql", content=insert, headers={"content-type": "application/sparql-update"})
    assert answer.status_code in (200, 204), answer.text
    assert "mine" in site.get("robots/rover/data/note", headers={"accept": "text/turtle"}).text
    assert site.get("robots/plane/data/note").status_code == 404
    assert ask(site, "sparql", "SELECT ?c { ?r rdfs:comment 'mine' ; rdfs:comment ?c }") == [["mine"]]
    both = insert + "; " + insert.replace("rover", "plane")
    refused = site.post("sparql", content=both, headers={"content-type": "application/sparql-update"})
    assert refused.status_code == 400
    assert "send one for each" in refused.text


def test_words_are_found_in_all_robots_with_their_values(site: httpx.Client) -> None:
    found = site.get("find", params={"q": "speed", "values": "true"}, headers=JSON).json()["results"]
    assert {each["url"].split("/")[4] for each in found} == {"rover", "plane"}
    assert {each["url"].split("/")[4] for each in found if "value" in each} == {"rover", "plane"}
    ages = ask(site, "sparql", "SELECT ?t ?a { ?t a ros:Topic BIND(ros:age(?t) AS ?a) FILTER(BOUND(?a)) }")
    assert {topic.split("/")[4] for topic, _ in ages} == {"rover", "plane"}


@pytest.mark.slow
def test_a_stop_at_a_robot_stops_one_and_at_the_base_all(site: httpx.Client) -> None:
    def stopped() -> list[bool]:
        return [each["stopped"] for each in site.get("robots/", headers=JSON).json()]

    def release(name: str) -> None:
        page = site.get(f"robots/{name}/stop", headers={"accept": "text/html"}).text
        id = page.partition("The id of this stop is ")[2].partition(".")[0]
        assert site.delete(f"robots/{name}/stop", params={"confirm": id}).status_code == 204

    assert site.post("robots/rover/stop").status_code == 200
    assert stopped() == [True, False]
    assert site.get("stop", headers=JSON).json()["stopped"] is False
    answer = site.post("stop", json={"reason": "smoke"}, headers=JSON)
    assert answer.json()["stopped"] is True
    assert [step["does"] for step in answer.json()["steps"]] == ["stop rover", "stop plane"]
    assert stopped() == [True, True]
    assert site.get("robots/plane/stop", headers=JSON).json()["reason"] == "smoke"
    assert site.delete("stop").status_code == 405
    release("rover")
    release("plane")
    assert stopped() == [False, False]


def test_the_base_is_described(site: httpx.Client) -> None:
    paths = site.get("openapi.json").json()["paths"]
    assert {"/robots/", "/sparql", "/find", "/stop", "/faults/"} <= paths.keys()
    assert "/topics/" not in paths
    assert f"{site.base_url}robots/" in site.get("llms.txt").text
    assert "/robots/{name}" not in site.get("robots/rover/openapi.json").json()["paths"]
    for path in ("faults/", "status", "data/", "queries/", "robots/"):
        assert site.get(path, headers={"accept": "text/html"}).status_code == 200, path


@pytest.mark.slow
async def test_a_robot_that_goes_away_takes_nothing_else_with_it_and_comes_back() -> None:
    site = Site("one", "two")
    site.broken.add("two")
    async with lifespan(site.robots):
        one, two = await site.get("robots/")
        assert (one["state"], two["state"], two["reason"]) == ("Live", "Stale", "its plug is pulled")
        assert (await site.http.get("robots/two/topics/")).status_code == 503
        assert (await site.http.post("stop")).status_code == 200
        site.broken.clear()
        await site.until(lambda: all(each.app is not None for each in site.robots))
        assert await site.put("robots/two/topics/number", 1) == 423, "it is stopped since it is connected"
        assert await site.put("robots/one/topics/number", 1) == 423
    assert [each.app for each in site.robots] == [None, None]


@pytest.mark.slow
async def test_a_ros_master_that_dies_takes_nothing_else_with_it_and_its_robot_comes_back(tmp_path: Path) -> None:
    site = Site("one")

    async def state() -> tuple[str, bool]:
        ros = (await site.get("robots/"))[1]
        return ros["state"], ros["reason"] is None

    async def until(state_then: str) -> None:
        while (await state()) != (state_then, state_then == "Live"):
            await asyncio.wait_for(changed.wait(), 20)
            changed.clear()

    with running(tmp_path) as system:
        async with lifespan(site.robots):
            changed = asyncio.Event()
            with closing(site.robots.changes.watch(changed.set)):
                added = {"name": "ros", "source": system.source}
                assert (await site.http.post("robots/", json=added)).status_code == 201
                await until("Live")
                await asyncio.to_thread(system.kill_master)
                await until("Stale")
                away = await site.http.get("robots/ros/readyz")
                assert (away.status_code, "robot stale" in away.text) == (503, True)
                entry = (await site.http.get("robots/ros/", headers={"accept": "text/turtle"})).text
                assert "does not answer" in entry or "cannot be reached" in entry
                assert await site.put("robots/one/topics/number", 1) == 204
                query = {"query": "SELECT ?t { ?t a ros:Topic }"}
                answer = await site.http.post("sparql", data=query, headers={"accept": "text/csv"})
                assert "http://127.0.0.1:8080/robots/one/topics/number" in answer.text
                assert (await site.http.post("stop")).status_code == 200
                await asyncio.to_thread(system.start_master)
                await until("Live")


async def test_robots_are_added_and_removed_while_the_server_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    site = Site("one")
    async with lifespan(site.robots):
        assert (await site.http.post("robots/", json={"name": "file", "source": "/etc/passwd"})).status_code == 403
        assert (await site.http.post("robots/", json={"name": "a/b", "source": "rover"})).status_code == 422
        assert (await site.http.post("robots/", json={"name": "one", "source": "rover"})).status_code == 409
        answer = await site.http.post("robots/", json={"name": "two", "source": "rover"})
        assert (answer.status_code, answer.headers["location"]) == (201, "http://127.0.0.1:8080/robots/two/")
        await site.until(lambda: all(each.app is not None for each in site.robots))
        assert await site.put("robots/two/topics/number", 5) == 204
        assert (await site.http.delete("robots/two/")).status_code == 204
        assert (await site.http.get("robots/two/topics/")).status_code == 404
        assert [each["name"] for each in await site.get("robots/")] == ["one"]


async def test_added_robots_are_kept_over_a_restart_with_a_data_folder(tmp_path: Path) -> None:
    html = {"accept": "text/html"}
    site = Site("one")
    async with lifespan(site.robots):
        assert (await site.http.post("robots/", json={"name": "two", "source": "rover"})).status_code == 201
        assert "two: added here, and gone after a restart" in (await site.http.get("robots/", headers=html)).text
    site = Site("one", data=tmp_path)
    async with lifespan(site.robots):
        for name in ("two", "three", "four"):
            added = {"name": name, "source": f"foxglove://robot/{name}"}
            assert (await site.http.post("robots/?dry-run=true", json=added)).status_code == 200
            assert (await site.http.post("robots/", json=added)).status_code == 201
        assert (await site.http.delete("robots/three/")).status_code == 204
        assert (tmp_path / "robots.json").stat().st_mode & 0o077 == 0, "sources may contain passwords"
        assert "after a restart" not in (await site.http.get("robots/", headers=html)).text
    site = Site("one", "four", data=tmp_path)
    site.broken.add("foxglove://robot/two")
    async with lifespan(site.robots):
        found = [(each["name"], each["source"], each["state"]) for each in await site.get("robots/")]
        two = ("two", "foxglove://robot/two", "Stale")
        assert found == [("one", "counting:one", "Live"), ("four", "counting:four", "Live"), two]


async def test_a_damaged_list_of_robots_ends_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for text in ('{"two": "rov', '{"two": 5}', '{"../two": "rover"}', "[]"):
        (tmp_path / "robots.json").write_text(text)
        site = Site("one", data=tmp_path)
        assert [each.name for each in site.robots] == ["one"]
        assert (tmp_path / "robots.damaged").read_text() == text
        assert "robots.json is damaged" in caplog.text
    (tmp_path / "robots.json").mkdir()  # which no file can replace
    site = Site("one", data=tmp_path)
    async with lifespan(site.robots):
        answer = await site.http.post("robots/", json={"name": "two", "source": "rover"})
        assert answer.status_code == 507
        assert [each["name"] for each in await site.get("robots/")] == ["one"]


async def test_robots_are_served_below_the_path_of_a_proxy() -> None:
    site = Site("one", base_url="http://127.0.0.1:8080/site/")
    async with lifespan(site.robots):
        assert [each["url"] for each in await site.get("robots/")] == ["http://127.0.0.1:8080/site/robots/one/"]
        assert await site.put("http://127.0.0.1:8080/site/robots/one/topics/number", 1) == 204
        assert await site.put("http://127.0.0.1:8080/robots/one/topics/number", 1) == 404
        insert = "INSERT DATA { GRAPH <robots/one/data/note> { <#it> rdfs:label 'mine' } }"
        answer = await site.http.post("sparql", content=insert, headers={"content-type": "application/sparql-update"})
        assert answer.status_code == 204, answer.text
        assert "mine" in (await site.http.get("robots/one/data/note", headers={"accept": "text/turtle"})).text
        assert site.robots.is_urgent(b"POST", b"/site/robots/one/stop")
        assert not site.robots.is_urgent(b"POST", b"/robots/one/stop")


@pytest.mark.slow
async def test_the_robots_share_another_store() -> None:
    store = Oxigraph()
    await asyncio.to_thread(store.start)
    try:
        site = Site("one", "two", store=store.url, store_rate=20.0)
        async with lifespan(site.robots):
            for name in ("one", "two"):
                turtle = {"content-type": "text/turtle"}
                await site.http.put(f"robots/{name}/data/x", content=f"<> <http://e.x/p> '{name}' .", headers=turtle)
            query = "SELECT ?g ?o { GRAPH ?g { ?s <http://e.x/p> ?o } } ORDER BY ?o"
            expected = [{"g": f"http://127.0.0.1:8080/robots/{name}/data/x", "o": name} for name in ("one", "two")]
            for _ in range(200):
                if (found := await asyncio.to_thread(store.select, query)) == expected:
                    break
                await asyncio.sleep(0.05)
            assert found == expected
            assert (await site.get("robots/one/mirror"))["pending"] == 0
    finally:
        await asyncio.to_thread(store.stop)


def open_files() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


async def test_a_robot_that_cannot_be_opened_costs_no_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rosld.server.robots.robots._PAUSE", 0.0)
    monkeypatch.setattr("rosld.server.robots.robots._LONGEST_PAUSE", 0.0)
    site = Site("one", data=tmp_path)
    site.broken.add("one")
    async with lifespan(site.robots):
        await site.until(lambda: len(site.opened["one"]) > 2)
        before = open_files()
        await site.until(lambda: len(site.opened["one"]) > 12)
        assert open_files() < before + 6


@pytest.mark.slow
async def test_the_recorded_past_of_all_robots_is_complete_or_refused(tmp_path: Path) -> None:
    site = Site("one", "two", history=("*",), data=tmp_path)

    async def rows(query: str, **parameters: str) -> list[list[str]]:
        answer = await site.http.post("sparql", data={"query": query, **parameters}, headers={"accept": "text/csv"})
        assert answer.status_code == 200, answer.text
        return [row.split(",") for row in answer.text.split()[1:]]

    async def refused(query: str) -> str:
        answer = await site.http.post("sparql", data={"query": query})
        assert answer.status_code == 400
        return answer.text

    data = "<https://w3id.org/rosld/types/std_msgs/msg/Int64#data>"
    one, two = "http://127.0.0.1:8080/robots/one/", "http://127.0.0.1:8080/robots/two/"
    async with lifespan(site.robots):
        for name, value in (("one", 1), ("two", 2), ("one", 3), ("two", 4), ("one", 5)):
            assert await site.put(f"robots/{name}/topics/number", value) == 204
        past = f"?t ros:past ?m . ?m {data} ?x ; ros:received ?r"
        for _ in range(200):
            if len(await rows(f"SELECT ?x {{ {past} }}")) == 5:  # the history is written on a thread
                break
        newest = await rows(f"SELECT ?x {{ {past} }} ORDER BY DESC(?r) LIMIT 3")
        assert newest == [["5"], ["4"], ["3"]]
        sums = await rows(f"SELECT ?t (SUM(?x) AS ?s) {{ {past} }} GROUP BY ?t ORDER BY ?t")
        assert sums == [[f"{one}topics/number", "9"], [f"{two}topics/number", "6"]]
        recorded = "SELECT ?x {{ ?t ros:past ?m . ?m {0} ?x ; ros:recordedIn <robots/{1}/bags/history/> }} ORDER BY ?x"
        assert await rows(recorded.format(data, "two")) == [["2"], ["4"]]
        assert await rows(f"SELECT ?x FROM <robots/two/bags/history/> {{ {past} }} ORDER BY ?x") == [["2"], ["4"]]
        of_two = f"<robots/two/topics/number> ros:past ?m . ?m {data} ?x ; ros:received ?r"
        assert await rows(f"SELECT ?x {{ {of_two} }} ORDER BY DESC(?r) LIMIT 1") == [["4"]]
        assert await rows(f"SELECT (SUM(?x) AS ?s) {{ {of_two} }}") == [["6"]]
        assert "connected robot" in await refused(f"SELECT ?x {{ {of_two.replace('two', 'three')} }}")
        ordered = f"BIND(ros:asOf(<robots/two/topics/number>, NOW()) AS ?m) ?m {data} ?x"
        assert await rows(f"SELECT ?x {{ {ordered} }}") == [["4"]]
        assert "no recording" in await refused(recorded.format(data, "three"))
        assert "one robot" in await refused("SELECT (ros:transform(?g, 'map') AS ?p) { ?m geo:hasGeometry ?g }")


AUTH = """
[[token]]
agent = "ann"
sha256 = "{ann}"
[[rule]]
agents = ["ann"]
modes = ["read", "control", "write"]
paths = ["/robots", "/robots/one/**", "/sparql", "/find", "/stop"]
"""


@pytest.mark.slow
async def test_rules_are_about_paths_below_the_base_of_the_server(tmp_path: Path) -> None:
    token = generate_token()
    file = tmp_path / "auth.toml"
    file.write_text(AUTH.format(ann=token_digest(token)))
    site = Site("one", "two", auth=file)
    async with lifespan(site.robots):
        assert (await site.http.get("robots/", headers=JSON)).status_code == 401
        site.http.headers["authorization"] = f"Bearer {token}"
        assert [each["name"] for each in await site.get("robots/")] == ["one"]
        assert (await site.http.put("robots/one/topics/number", json={"data": 1})).status_code == 204
        assert (await site.http.put("robots/two/topics/number", json={"data": 1})).status_code == 404
        assert (await site.http.post("robots/", json={"name": "three", "source": "rover"})).status_code == 403
        assert (await site.http.delete("robots/one/")).status_code == 403
        query = {"query": "SELECT ?t { ?t a ros:Topic }"}
        answer = await site.http.post("sparql", data=query, headers={"accept": "text/csv"})
        assert answer.text.split() == ["t", "http://127.0.0.1:8080/robots/one/topics/number"]
        assert "two" not in (await site.http.get("robots/", headers={"accept": "text/turtle"})).text
        assert "two" not in (await site.http.get("robots/", headers={"accept": "text/html"})).text


def test_sources_with_names_are_several_robots(tmp_path: Path) -> None:
    assert named_sources(["a=rover", "b=ros2:?domain=1"]) == {"a": "rover", "b": "ros2:?domain=1"}
    assert named_sources(["ros2:?domain=1"]) is None
    assert joined(["a=rover", "b=aircraft"]) == "a=rover\nb=aircraft"
    for words, reason in ((["a=rover", "aircraft"], "must be NAME=SOURCE"), (["a=rover", "a=aircraft"], "two robots")):
        with pytest.raises(ValueError, match=reason):
            named_sources(words)
