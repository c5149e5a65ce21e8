"""Traces of requests by OpenTelemetry, if its SDK is installed (`rosld[otel]`) and OTEL_* variables configure it.

Nothing of it is imported otherwise, and a span costs a look-up.
"""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from importlib.metadata import entry_points
from typing import TYPE_CHECKING

import rosld

if TYPE_CHECKING:
    from opentelemetry.sdk.trace.export import SpanExporter
    from opentelemetry.trace import Span

_log = logging.getLogger("rosld")
_ENDPOINTS = ("OTEL_EXPORTER_OTLP_ENDPOINT", "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT")
_FLUSH_SECONDS = 2.0
"""Seconds at the end of the server for sending the last spans."""

current_request_id: ContextVar[str | None] = ContextVar("request_id", default=None)
"""Identifier of the current task's request, for the log."""
_current: ContextVar[Tracing | None] = ContextVar("tracing", default=None)


class Tracing:
    """Spans of one server, sent by exporters of OpenTelemetry."""

    def __init__(self, exporters: list[SpanExporter], environment: Mapping[str, str]) -> None:
        from opentelemetry.sdk.resources import Resource
        from opentelemetry.sdk.trace import TracerProvider
        from opentelemetry.sdk.trace.export import BatchSpanProcessor
        from opentelemetry.trace import SpanKind, StatusCode
        from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

        attributes = {"service.version": rosld.__version__}
        named = environment.get("OTEL_SERVICE_NAME"), environment.get("OTEL_RESOURCE_ATTRIBUTES", "")
        if not named[0] and "service.name=" not in named[1]:
            attributes["service.name"] = "rosld"
        self._provider = TracerProvider(resource=Resource.create(attributes), shutdown_on_exit=False)
        for exporter in exporters:
            self._provider.add_span_processor(BatchSpanProcessor(exporter))
        self._tracer = self._provider.get_tracer("rosld", rosld.__version__)
        self._extract, self._kind = TraceContextTextMapPropagator().extract, SpanKind.SERVER
        self._failed = StatusCode.ERROR

    @contextmanager
    def request(
        self, name: str, headers: Mapping[str, str], attributes: Mapping[str, str | int]
    ) -> Iterator[tuple[Span, str]]:
        """Trace a request as a child of the span in its `traceparent`, and yield its span and trace-id."""
        context, token = self._extract(headers), _current.set(self)
        try:
            with self._tracer.start_as_current_span(name, context, self._kind, attributes) as started:
                yield started, f"{started.get_span_context().trace_id:032x}"
        finally:
            _current.reset(token)

    def mark_failed(self, span: Span) -> None:
        """Set the status of a span to an error of the server."""
        span.set_status(self._failed)

    def child(self, name: str, attributes: Mapping[str, str]) -> AbstractContextManager[object]:
        """Return the context of a span below the current one."""
        child: AbstractContextManager[object] = self._tracer.start_as_current_span(name, attributes=attributes)
        return child

    async def close(self) -> None:
        """Send the last spans, in a thread that the end of the process does not wait for."""
        ended = threading.Event()

        def shut_down() -> None:
            self._provider.shutdown()
            ended.set()

        threading.Thread(target=shut_down, name="rosld-tracing", daemon=True).start()
        await asyncio.to_thread(ended.wait, _FLUSH_SECONDS)


def child_span(name: str, attributes: Mapping[str, str]) -> AbstractContextManager[object] | None:
    """Return the context of a span below that of the current request, None if requests are not traced."""
    tracing = _current.get()
    return None if tracing is None else tracing.child(name, attributes)


def tracing_of(environment: Mapping[str, str]) -> Tracing | None:
    """Return the tracing that the variables of OpenTelemetry configure; None without any, or without its SDK."""
    chosen = environment.get("OTEL_TRACES_EXPORTER", "")
    if environment.get("OTEL_SDK_DISABLED", "").lower() == "true" or chosen == "none":
        return None
    if not chosen and not any(environment.get(each) for each in _ENDPOINTS):
        return None
    try:
        return Tracing([_exporter(name.strip(), environment) for name in (chosen or "otlp").split(",")], environment)
    except (ImportError, LookupError) as error:
        _log.warning("requests are not traced although OTEL_* is set: %s; pip install 'rosld[otel]'", error)
        return None


def _exporter(name: str, environment: Mapping[str, str]) -> SpanExporter:
    """Return the exporter of a name, as installed packages register them. Raises LookupError."""
    if name == "otlp":
        protocol = environment.get("OTEL_EXPORTER_OTLP_PROTOCOL", "http/protobuf")
        name = "otlp_proto_grpc" if protocol == "grpc" else "otlp_proto_http"
    for found in entry_points(group="opentelemetry_traces_exporter", name=name):
        exporter: SpanExporter = found.load()()
        return exporter
    raise LookupError(f"the exporter {name} is not installed")
