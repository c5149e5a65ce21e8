"""Identifiers of requests in responses, and the log as JSON."""

from __future__ import annotations

import io
import json
import logging
import re
from pathlib import Path
from typing import Any

import pytest

from rosld.server.http.request_id import request_id
from rosld.server.serving.http_server import configure_logging
from tests.server.auth.conftest import rule, token, tokens
from tests.server.robots.made_up import MadeUp, Serving, served
from tests.waiting import until

TRACE, PARENT = "4bf92f3577b34da6a3ce929d0e0e4736", "00f067aa0ba902b7"
NEW = re.compile(r"[0-9a-f]{32}")


def test_the_id_of_a_request_is_the_clients_that_of_its_trace_or_a_new_one() -> None:
    valid = f"00-{TRACE}-{PARENT}-01"
    assert request_id({"traceparent": valid}) == TRACE
    assert request_id({"traceparent": valid, "x-request-id": "job-7"}) == "job-7"
    assert request_id({"traceparent": f"cc-{TRACE}-{PARENT}-01-what-is-next"}) == TRACE
    secret = f"rosld_{'aB' * 21}c"
    for bad in (
        {}, {"x-request-id": ""}, {"x-request-id": "a b"}, {"x-request-id": "a" * 129}, {"x-request-id": secret},
        {"traceparent": f"00-{TRACE}-{PARENT}-01-more"}, {"traceparent": f"ff-{TRACE}-{PARENT}-01"},
        {"traceparent": f"00-{'0' * 32}-{PARENT}-01"}, {"traceparent": f"00-{TRACE}-{'0' * 16}-01"},
        {"traceparent": f"00-{TRACE.upper()}-{PARENT}-01"}, {"traceparent": valid + ", " + valid},
    ):  # fmt: skip
        assert NEW.fullmatch(request_id(bad)), bad


def test_refusals_writes_and_requests_with_an_id_are_answered_with_it(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/in", "std_msgs/msg/Float64", published=False, heard=True)
    http = serving()
    assert "x-request-id" not in http.get("topics/").headers
    assert http.get("topics/", headers={"X-Request-Id": "mine"}).headers["x-request-id"] == "mine"
    parent = {"traceparent": f"00-{TRACE}-{PARENT}-00"}
    assert http.get("topics/", headers=parent).headers["x-request-id"] == TRACE
    first, second = http.get("nowhere"), http.get("nowhere")
    assert NEW.fullmatch(first.headers["x-request-id"])
    assert first.headers["x-request-id"] != second.headers["x-request-id"]
    assert NEW.fullmatch(http.put("topics/in", json={"data": 1}).headers["x-request-id"])


@pytest.fixture
def log(monkeypatch: pytest.MonkeyPatch) -> io.StringIO:
    """The text that a server with `--log-format json` logs."""
    written = io.StringIO()
    monkeypatch.setattr("sys.stderr", written)
    monkeypatch.setattr(logging.root, "handlers", [])
    monkeypatch.setattr(logging.root, "level", logging.root.level)
    configure_logging("json")
    return written


def lines(log: io.StringIO) -> list[dict[str, Any]]:
    return [json.loads(line) for line in log.getvalue().splitlines()]


def test_the_log_as_json_has_a_line_for_each_request_with_agent_and_receipt(
    log: io.StringIO, robot: MadeUp, tmp_path: Path
) -> None:
    robot.topic("/in", "std_msgs/msg/Float64", published=False, heard=True)
    auth = tmp_path / "auth.toml"
    auth.write_text(rule("anna", "read control", "/**") + tokens("anna"))
    headers = {"Authorization": f"Bearer {token('anna')}", "X-Request-Id": "job-7"}
    with served(robot, auth=auth, log_format="json") as http:
        written = http.put("topics/in", json={"data": 1}, headers=headers)
        http.get(f"topics/rosld_{'aB' * 21}c")
        http.get("healthz")
    found = [each for each in lines(log) if each["logger"] == "rosld.requests"]
    assert [each["status"] for each in found] == [204, 401]
    assert "aBaB" not in log.getvalue()
    first = found[0]
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}\+00:00", first["time"])
    assert 0 < first["duration"] < 60
    assert f"/activity/{first['receipt']}>" in written.headers["link"]
    same = {
        "level": "INFO", "message": "PUT /topics/in 204", "request_id": "job-7", "method": "PUT", "path": "/topics/in",
        "route": "/topics/{name}", "agent": "anna",
    }  # fmt: skip
    assert same.items() <= first.items()


def test_a_failure_has_its_id_in_the_response_and_in_the_log(
    log: io.StringIO, robot: MadeUp, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError("a bug")

    with served(robot, log_format="json") as http:
        monkeypatch.setattr("rosld.server.resources.entry_point.status_document", fail)
        monkeypatch.setattr("rosld.server.resources.entry_point._plain", fail)
        answer = http.get("status", headers={"Accept": "application/problem+json, application/json"})
        assert answer.status_code == 500
        id = answer.headers["x-request-id"]
        assert answer.json()["requestId"] == id
        failed = until(lambda: [each for each in lines(log) if "exception" in each], "a traceback")
    assert (failed[0]["request_id"], failed[0]["level"]) == (id, "ERROR")
    assert "ZeroDivisionError: a bug" in failed[0]["exception"]
    assert id in failed[0]["message"]
