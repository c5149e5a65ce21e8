"""Traces of requests: spans of OpenTelemetry for the request, its queries and its commands to the robot."""

from __future__ import annotations

import logging
from collections.abc import Mapping

import pytest
from opentelemetry.sdk.trace import ReadableSpan
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter
from opentelemetry.trace import SpanKind, StatusCode

from rosld.server.runtime.tracing import tracing_of
from tests.server.robots.made_up import MadeUp, served

TRACE, PARENT = "4bf92f3577b34da6a3ce929d0e0e4736", "00f067aa0ba902b7"


@pytest.fixture
def exporter(monkeypatch: pytest.MonkeyPatch) -> InMemorySpanExporter:
    """The exporter of the servers of a test."""
    found = InMemorySpanExporter()
    monkeypatch.setenv("OTEL_TRACES_EXPORTER", "memory")
    monkeypatch.setattr("rosld.server.runtime.tracing._exporter", lambda name, environment: found)
    return found


def spans_of(exporter: InMemorySpanExporter) -> dict[str, ReadableSpan]:
    return {span.name: span for span in exporter.get_finished_spans()}


def test_a_request_is_a_span_below_that_of_its_client_with_its_command_below_it(
    exporter: InMemorySpanExporter, robot: MadeUp
) -> None:
    robot.topic("/in", "std_msgs/msg/Float64", published=False, heard=True)
    with served(robot) as http:
        headers = {"traceparent": f"00-{TRACE}-{PARENT}-01", "User-Agent": "test"}
        answer = http.put("topics/in", json={"data": 1}, headers=headers)
        assert answer.headers["x-request-id"] == TRACE
        port = http.base_url.port
    spans = spans_of(exporter)
    request, command = spans["PUT /topics/{name}"], spans["publish"]
    assert (request.kind, request.status.status_code) == (SpanKind.SERVER, StatusCode.UNSET)
    assert f"{request.context.trace_id:032x}" == TRACE
    assert f"{request.parent.span_id:016x}" == PARENT
    assert dict(request.attributes) == {
        "http.request.method": "PUT", "http.route": "/topics/{name}", "http.response.status_code": 204,
        "url.path": "/topics/in", "url.scheme": "http", "server.address": "127.0.0.1", "server.port": port,
        "network.protocol.version": "1.1", "user_agent.original": "test",
    }  # fmt: skip
    assert command.parent.span_id == request.context.span_id
    assert dict(command.attributes) == {"rosld.name": "/in"}
    assert request.resource.attributes["service.name"] == "rosld"


def test_queries_are_spans_and_a_request_without_a_parent_has_the_id_of_its_trace(
    exporter: InMemorySpanExporter, robot: MadeUp
) -> None:
    with served(robot) as http:
        assert http.get("sparql", params={"query": "ASK {}"}).status_code == 200
        refused = http.get("nowhere")
    spans = spans_of(exporter)
    assert spans["query"].parent.span_id == spans["GET /sparql"].context.span_id
    unknown = spans["GET {unknown}"]
    assert unknown.parent is None
    assert refused.headers["x-request-id"] == f"{unknown.context.trace_id:032x}"
    assert unknown.attributes["http.response.status_code"] == 404


@pytest.mark.parametrize(
    "environment",
    [
        {},
        {"OTEL_SERVICE_NAME": "robot"},
        {"OTEL_TRACES_EXPORTER": "none", "OTEL_EXPORTER_OTLP_ENDPOINT": "http://127.0.0.1:1"},
        {"OTEL_SDK_DISABLED": "true", "OTEL_EXPORTER_OTLP_ENDPOINT": "http://127.0.0.1:1"},
    ],
)
def test_nothing_is_traced_unless_an_exporter_is_configured(environment: Mapping[str, str]) -> None:
    assert tracing_of(environment) is None


def test_an_exporter_that_is_not_installed_is_named_in_the_log(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "rosld"):
        assert tracing_of({"OTEL_TRACES_EXPORTER": "nobodys"}) is None
    assert "nobodys is not installed" in caplog.text
    assert "rosld[otel]" in caplog.text
