"""OpenTelemetry's own exporter sends the spans of a server to a collector (OTLP over HTTP)."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest

from tests.interop.missing import missing


@pytest.fixture
def collector() -> Iterator[tuple[str, queue.Queue[bytes]]]:
    """The URL of a collector, and the bodies that it receives at /v1/traces."""
    bodies: queue.Queue[bytes] = queue.Queue()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["content-length"]))
            if self.path == "/v1/traces":
                bodies.put(body)
            self.send_response(200)
            self.send_header("content-length", "0")
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}", bodies
        server.shutdown()


def test_a_collector_receives_spans_when_the_server_ends_at_the_latest(
    start_server: Callable[..., Any], collector: tuple[str, queue.Queue[bytes]]
) -> None:
    try:
        from opentelemetry.exporter.otlp.proto.http import Compression
        from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
    except ImportError:
        missing("there is no OTLP exporter: pip install 'rosld[otel]'")
    assert Compression.NoCompression
    url, bodies = collector
    served = start_server("aircraft", environment={**os.environ, "OTEL_EXPORTER_OTLP_ENDPOINT": url})
    assert served.http.get("topics/").status_code == 200
    assert served.http.get("sparql", params={"query": "ASK {}"}).status_code == 200
    assert served.stop() == 0
    spans = {}
    for body in [bodies.get(timeout=20), *(bodies.get() for _ in range(bodies.qsize()))]:
        for resource in ExportTraceServiceRequest.FromString(body).resource_spans:
            attributes = {each.key: each.value.string_value for each in resource.resource.attributes}
            assert attributes["service.name"] == "rosld"
            spans |= {span.name: span for scope in resource.scope_spans for span in scope.spans}
    assert {"GET /topics/", "GET /sparql", "query"} <= spans.keys()
    assert spans["query"].parent_span_id == spans["GET /sparql"].span_id
