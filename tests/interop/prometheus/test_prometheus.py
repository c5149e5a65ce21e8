"""Prometheus and its promtool (Debian's `prometheus`) on `/metrics` and on the files in `deploy/`."""

from __future__ import annotations

import json
import socket
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.interop.missing import require
from tests.server.auth.conftest import rule, token, tokens
from tests.waiting import until

DEPLOY = Path(__file__).parents[3] / "deploy"


def promtool(*arguments: str, given: str | None = None) -> str:
    """Return the output of promtool, which finds no fault."""
    require("promtool")
    done = subprocess.run(
        ["promtool", *arguments], input=given, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


def test_promtool_finds_no_fault_in_the_metrics_of_a_busy_server(server: Any) -> None:
    http = server.http
    for path in ("topics/aircraft/engine/speed", "sparql?query=ASK%20%7B%7D", "nowhere", "resources/"):
        http.get(path)
    http.put("topics/cockpit/display", json={"data": "x"})
    assert promtool("check", "metrics", given=http.get("metrics").text) == ""


def test_promtool_accepts_the_configuration_and_the_alerts() -> None:
    assert "SUCCESS" in promtool("check", "config", str(DEPLOY / "prometheus.yml"))


@pytest.fixture(scope="module")
def prometheus(
    start_server: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Callable[[str], list[Any]]]:
    """Return the result of a query to a Prometheus that scrapes an aircraft with its token four times a second."""
    require("prometheus")
    folder = tmp_path_factory.mktemp("prometheus")
    auth = folder / "auth.toml"
    auth.write_text(rule("prometheus", "read", "/metrics", "/topics/**") + tokens("prometheus"))
    aircraft = start_server("aircraft", "--auth", str(auth), "--subscribe", "*", "--history", "*")
    (folder / "token").write_text(token("prometheus"))
    config = (DEPLOY / "prometheus.yml").read_text("utf-8")
    config = config.replace("127.0.0.1:8080", aircraft.url.removeprefix("http://").strip("/"))
    config = config.replace("    # authorization:\n    #   cred", "    authorization:\n      cred")
    config = config.replace("/etc/prometheus/rosld.token", "token").replace("15s", "250ms")
    (folder / "prometheus.yml").write_text(config)
    (folder / "alerts.yml").write_bytes((DEPLOY / "alerts.yml").read_bytes())
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = f"127.0.0.1:{free.getsockname()[1]}"
    command = ["prometheus", f"--config.file={folder}/prometheus.yml", f"--storage.tsdb.path={folder}/data"]
    with subprocess.Popen([*command, f"--web.listen-address={address}"], stderr=subprocess.DEVNULL) as process:
        try:
            with httpx.Client(base_url=f"http://{address}", timeout=20) as http:

                def query(text: str) -> list[Any]:
                    try:
                        response = http.get("/api/v1/query", params={"query": text})
                    except httpx.TransportError:  # it has just been started
                        return []
                    if response.status_code == 503:  # it reads its storage
                        return []
                    answer = response.json()
                    assert answer["status"] == "success", (text, answer)
                    result: list[Any] = answer["data"]["result"]
                    return result

                yield query
        finally:
            process.terminate()
            process.wait(20)


def test_prometheus_scrapes_a_server_with_a_token(prometheus: Callable[[str], list[Any]]) -> None:
    found = until(lambda: prometheus("rosld_robot_up"), "a scrape")
    assert found[0]["value"][1] == "1"
    topics = until(lambda: prometheus("rosld_topic_last_message_age_seconds"), "topics")
    assert any(each["metric"]["topic"] == "/aircraft/engine/speed" for each in topics)
    assert until(lambda: prometheus('rate(rosld_http_requests_total{route="/metrics",status="200"}[1m]) > 0'), "a rate")
    assert prometheus("ALERTS") == []


def test_prometheus_evaluates_every_query_of_the_dashboard(prometheus: Callable[[str], list[Any]]) -> None:
    dashboard = json.loads((DEPLOY / "grafana" / "rosld.json").read_text("utf-8"))
    idle = {"Commands to the robot", "Queries", "Duration of queries"}  # nobody commands or queries it

    def empty() -> set[str]:
        found = set()
        for panel in dashboard["panels"]:
            for target in panel["targets"]:
                text = target["expr"].replace("$__rate_interval", "1m").replace("$instance", ".*")
                if not prometheus(text.replace("$topic", ".*")):
                    found.add(panel["title"])
        return found

    until(lambda: empty() <= idle, "values in every panel")
