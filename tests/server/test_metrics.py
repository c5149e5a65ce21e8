"""`/metrics`: counts of requests, queries and commands, and the state of robot and server, as Prometheus reads them."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from pathlib import Path

import httpx
import pytest
from prometheus_client.openmetrics.parser import text_string_to_metric_families as openmetrics_families
from prometheus_client.parser import text_string_to_metric_families

from rosld.server.runtime.process_memory import process_usage
from tests.server.auth.conftest import rule, token, tokens
from tests.server.robots.made_up import MadeUp, Serving, served
from tests.waiting import until

DEPLOY = Path(__file__).parents[2] / "deploy"
Samples = Mapping[str, Mapping[frozenset[tuple[str, str]], float]]
OPENMETRICS = "application/openmetrics-text; version=1.0.0"


def scrape(http: httpx.Client, **headers: str) -> dict[str, dict[frozenset[tuple[str, str]], float]]:
    """Return the samples by name and labels."""
    response = http.get("metrics", headers=headers)
    assert response.status_code == 200, response.text
    found: dict[str, dict[frozenset[tuple[str, str]], float]] = {}
    for family in text_string_to_metric_families(response.text):
        for sample in family.samples:
            found.setdefault(sample.name, {})[frozenset(sample.labels.items())] = sample.value
    return found


def value(found: Samples, name: str, **labels: str) -> float:
    """Return the value of a sample, 0 if it is missing."""
    return found.get(name, {}).get(frozenset(labels.items()), 0.0)


def topics_of(found: Samples, name: str) -> set[str]:
    """Return the topics that have a sample of this name."""
    return {dict(labels)["topic"] for labels in found.get(name, {})}


def test_requests_are_counted_by_route_and_status(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/a/speed", "std_msgs/msg/Float64", {"data": 1.0})
    http = serving()
    for path in ("topics/a/speed", "topics/a/speed", "topics/", "topics/missing", "nowhere", "nowhere/else"):
        http.get(path)
    http.request("PROPFIND", "topics/")
    found = scrape(http)
    name = "rosld_http_requests_total"
    assert value(found, name, method="GET", route="/topics/{name}", status="200") == 2
    assert value(found, name, method="GET", route="/topics/{name}", status="404") == 1
    assert value(found, name, method="GET", route="/topics/", status="200") == 1
    assert value(found, name, method="GET", route="{unknown}", status="404") == 2
    assert sum(each for labels, each in found[name].items() if ("method", "other") in labels) == 1
    duration = "rosld_http_request_duration_seconds"
    assert value(found, f"{duration}_count", method="GET", route="/topics/{name}") == 3
    assert value(found, f"{duration}_bucket", method="GET", route="/topics/{name}", le="+Inf") == 3
    assert value(found, f"{duration}_sum", method="GET", route="/topics/{name}") > 0
    assert value(found, "rosld_http_requests_in_progress") == 1, "the scrape itself"
    assert value(scrape(http), name, method="GET", route="/metrics", status="200") == 1


def test_topics_have_rates_and_ages_up_to_a_limit_and_only_if_subscribed(robot: MadeUp, serving: Serving) -> None:
    for name in ("/a", "/b", "/c", "/unread"):
        robot.topic(name, "std_msgs/msg/Float64", {"data": 1.0})
    http = serving(metrics_topics=2)
    for name in ("a", "b", "c"):
        http.get(f"topics/{name}")
    found = scrape(http)
    age = "rosld_topic_last_message_age_seconds"
    assert topics_of(found, age) == {"/a", "/b"}
    assert all(0 <= each < 60 for each in found[age].values())
    assert (value(found, "rosld_topics_subscribed"), value(found, "rosld_topics_omitted")) == (3, 1)
    assert value(found, "rosld_robot_topics") == 4


@pytest.mark.slow
def test_commands_and_queries_are_timed_by_outcome(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/in", "std_msgs/msg/Float64", published=False, heard=True)
    http = serving()
    assert http.put("topics/in", json={"data": 1}).status_code == 204
    assert http.put("topics/in", json={"data": 1}, params={"dry-run": "true"}).status_code == 200
    assert http.get("sparql", params={"query": "ASK {}"}).status_code == 200
    slow = "SELECT (COUNT(*) AS ?n) { ?a ?b ?c . ?d ?e ?f . ?g ?h ?i . ?j ?k ?l }"
    assert http.get("sparql", params={"query": slow, "timeout": "0.3"}).status_code == 503
    assert http.get("sparql", params={"query": "nonsense"}).status_code == 400
    http.post("stop")
    assert http.put("topics/in", json={"data": 2}).status_code == 423
    found = scrape(http)
    name = "rosld_command_duration_seconds_count"
    assert value(found, name, command="publish", outcome="ok") >= 1
    assert value(found, name, command="publish", outcome="dry_run") == 0
    assert value(found, "rosld_query_duration_seconds_count", outcome="ok") == 1
    assert value(found, "rosld_query_duration_seconds_count", outcome="time") == 1
    assert value(found, "rosld_http_requests_total", method="PUT", route="/topics/{name}", status="423") == 1
    assert value(found, "rosld_robot_stopped") == 1
    assert value(found, "rosld_query_process_up") == 1


def test_the_state_of_robot_and_server_is_read_when_it_is_scraped(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/a", "std_msgs/msg/Float64", {"data": 1.0})
    http = serving(history=("/a",))
    until(lambda: value(scrape(http), "rosld_history_messages_total") == 1, "a recorded message")
    with http.stream("GET", "topics/a", headers={"Accept": "text/event-stream"}) as stream:
        events = stream.iter_raw()
        next(events)
        found = scrape(http)
        assert (value(found, "rosld_event_streams"), value(found, "rosld_http_requests_in_progress")) == (1, 2)
        assert value(found, "rosld_connections") >= 2
    assert value(found, "rosld_robot_up") == value(found, "rosld_history_enabled") == 1
    assert value(found, "process_resident_memory_bytes") > 10_000_000
    assert value(found, "rosld_query_process_resident_memory_bytes") > 10_000_000
    assert found["rosld_query_process_cpu_seconds_total"]
    assert process_usage(os.getpid())[0] > 0
    assert found["rosld_build_info"]
    robot.goes_stale("nobody answers")
    until(lambda: value(scrape(http), "rosld_robot_up") == 0, "the robot is away")


def test_the_format_is_negotiated(http: httpx.Client) -> None:
    assert http.get("metrics").headers["content-type"].startswith("text/plain; version=0.0.4")
    response = http.get("metrics", headers={"Accept": OPENMETRICS})
    assert response.headers["content-type"].startswith("application/openmetrics-text; version=1.0.0")
    names = {family.name for family in openmetrics_families(response.text)}
    assert {"rosld_http_requests", "rosld_robot_up", "process_cpu_seconds"} <= names
    assert http.get("metrics", headers={"Accept": "image/png"}).status_code == 406
    assert http.head("metrics").status_code == 200
    assert http.get("openapi.json").json()["paths"]["/metrics"]["get"]


def test_an_agent_with_a_rule_for_metrics_sees_only_topics_that_it_may_read(tmp_path: Path, robot: MadeUp) -> None:
    robot.topic("/open", "std_msgs/msg/Float64", {"data": 1.0})
    robot.topic("/secret", "std_msgs/msg/Float64", {"data": 1.0})
    rules = (
        rule("prometheus", "read", "/metrics")
        + rule("grafana", "read", "/metrics", "/topics/open")
        + rule("admin", "read", "/**")
    )
    auth = tmp_path / "auth.toml"
    auth.write_text(rules + tokens("prometheus", "grafana", "admin"))
    age = "rosld_topic_last_message_age_seconds"
    with served(robot, auth=auth, subscribe=("*",)) as http:
        as_admin = {"Authorization": f"Bearer {token('admin')}"}
        until(lambda: topics_of(scrape(http, **as_admin), age) == {"/open", "/secret"}, "both topics")
        assert http.get("metrics").status_code == 401
        expected: dict[str, set[str]] = {"prometheus": set(), "grafana": {"/open"}}
        for agent, topics in expected.items():
            found = scrape(http, Authorization=f"Bearer {token(agent)}")
            assert topics_of(found, age) == topics
            assert value(found, "rosld_robot_topics") == len(topics)
            assert value(found, "rosld_robot_up") == 1


def test_the_dashboard_and_the_alerts_name_only_metrics_that_exist(http: httpx.Client) -> None:
    found = http.get("metrics").text
    dashboard = json.loads((DEPLOY / "grafana" / "rosld.json").read_text("utf-8"))
    texts = [each["expr"] for panel in dashboard["panels"] for each in panel["targets"]]
    texts += [(DEPLOY / "alerts.yml").read_text("utf-8"), (DEPLOY.parent / "docs/how-to/watch.md").read_text("utf-8")]
    families = {line.split()[2] for line in found.splitlines() if line.startswith("# TYPE")}
    named = {each for text in texts for each in re.findall(r"\b(?:rosld|process)_[a-z]+_\w*[a-z]\b", text)}
    suffixes = ("", "_total", "_count", "_bucket", "_info")
    unknown = {each for each in named if not any(each.removesuffix(one) in families for one in suffixes)}
    assert not unknown - families
    assert len(named) > 30
