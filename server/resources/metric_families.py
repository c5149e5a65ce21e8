"""Families of metrics in the terms of prometheus_client, and their text. Imported by the first scrape."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from prometheus_client import Metric, ProcessCollector
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, InfoMetricFamily
from prometheus_client.exposition import choose_encoder

import rosld
from rosld.adapters.model import Live
from rosld.server.auth.permissions import Permissions
from rosld.server.runtime.process_memory import process_usage
from rosld.server.runtime.timings import BOUNDS, Histogram, RequestTimings, Timings

if TYPE_CHECKING:
    from rosld.server.resources.metrics import MetricSources


class _Collected:
    """A registry of families that are already collected."""

    def __init__(self, families: Sequence[Metric]) -> None:
        self._families = families

    def collect(self) -> Iterable[Metric]:
        return self._families


def render(families: Sequence[Metric], accept: str) -> tuple[bytes, str]:
    """Return the families in the format that the client prefers, and its media type."""
    encode, media_type = choose_encoder(accept)
    body: bytes = encode(_Collected(families))
    return body, str(media_type)


def collect(sources: MetricSources, permissions: Permissions) -> list[Metric]:
    """Return all families, with the topics, holds and faults that the agent may read."""
    return [
        InfoMetricFamily("rosld_build", "Version of rosld.", value={"version": rosld.__version__}),
        *_requests(sources.requests),
        *_load(sources),
        *_robot(sources, permissions),
        *_topics(sources, permissions),
        *_history(sources),
        *ProcessCollector(registry=None).collect(),
    ]


def _gauge(name: str, words: str, value: float) -> Metric:
    return GaugeMetricFamily(f"rosld_{name}", words, value=value)


def _counter(name: str, words: str, value: float) -> Metric:
    return CounterMetricFamily(f"rosld_{name}", words, value=value)


def _labelled(family: Metric, values: Iterable[tuple[tuple[str, ...], float]]) -> Metric:
    for labels, value in values:
        family.add_metric(labels, value)
    return family


def _histograms(name: str, words: str, labels: Sequence[str], found: Mapping[tuple[str, ...], Histogram]) -> Metric:
    family = HistogramMetricFamily(f"rosld_{name}", words, labels=labels)
    for values, histogram in found.items():
        buckets, total = [], 0
        for bound, count in zip((*map(str, BOUNDS), "+Inf"), histogram.counts, strict=True):
            total += count
            buckets.append((bound, total))
        family.add_metric(values, buckets, histogram.sum)
    return family


def _requests(requests: RequestTimings) -> Iterator[Metric]:
    counts: Counter[tuple[str, ...]] = Counter()
    durations: defaultdict[tuple[str, ...], Histogram] = defaultdict(Histogram)
    for (route, is_whole, method, status), histogram in list(requests.histograms.items()):
        template = requests.template(route, is_whole)
        counts[method, template, str(status)] += sum(histogram.counts)
        durations[method, template].include(histogram)
    labels = ("method", "route", "status")
    words = "Answered requests; refusals have a status of 400 or more, 429 at a rate limit."
    yield _labelled(CounterMetricFamily("rosld_http_requests", words, labels=labels), counts.items())
    words = "Time from the head of a request to the head of its response."
    yield _histograms("http_request_duration_seconds", words, labels[:2], durations)
    yield _gauge("http_requests_in_progress", "Requests in progress, including streams.", requests.current)


def _load(sources: MetricSources) -> Iterator[Metric]:
    process, watchdog = sources.process, sources.watchdog
    yield _gauge("connections", "Open connections, including WebSockets.", sources.connections())
    yield _gauge("websockets", "Open WebSockets.", sources.clients.websockets)
    yield _gauge("event_streams", "Event streams and requests that wait for a change.", sources.broadcasters.readers)
    words = "Pauses of the event loop of 20 ms or more."
    yield _counter("event_loop_pauses", words, watchdog.count)
    yield _counter("event_loop_pause_seconds", "Total length of these pauses.", watchdog.seconds)
    words = "Longest pause of the event loop in the last minute."
    yield _gauge("event_loop_longest_pause_seconds", words, watchdog.pauses.recent)
    words = "Time from the start of a SPARQL query to its result, or the beginning of a long one, by outcome."
    yield _by_operation("query_duration_seconds", words, ("outcome",), sources.services.sparql.timings)
    yield _gauge("queries_running", "SPARQL queries and updates in progress.", process.running)
    yield _gauge("queries_queued", "SPARQL queries and updates that wait for a worker.", process.waiting)
    yield _gauge("query_process_up", "Whether the query process runs.", process.is_running)
    seconds, size = process_usage(process.pid) if process.pid else (0.0, 0)
    words = "CPU time of the query process and its workers, without running queries."
    yield _counter("query_process_cpu_seconds", words, seconds)
    yield _gauge("query_process_resident_memory_bytes", "Memory of the query process, without its workers.", size)


def _by_operation(name: str, words: str, labels: Sequence[str], timings: Timings) -> Metric:
    return _histograms(name, words, labels, {key[-len(labels) :]: each for key, each in timings.histograms.items()})


def _robot(sources: MetricSources, permissions: Permissions) -> Iterator[Metric]:
    session = sources.services.session
    graph, space = session.graph, session.space
    yield _gauge("robot_up", "Whether the robot can be reached.", isinstance(graph.state, Live))
    yield _gauge("robot_stopped", "Whether the robot is stopped by POST /stop.", session.is_stopped)
    for kind, names, url in (
        ("nodes", graph.nodes, space.node),
        ("topics", graph.topics, space.topic),
        ("services", graph.services, space.service),
    ):
        count = sum(permissions.may_read(url(name)) for name in names)
        yield _gauge(f"robot_{kind}", f"{kind.capitalize()} of the robot.", count)
    holds = sum(permissions.may_read(space.hold(hold.id)) for hold in sources.services.holds.all())
    yield _gauge("holds", "Topics that agents hold.", holds)
    faults = Counter(
        (fault.severity.value,)
        for fault in sources.services.faults.all()
        if not fault.is_healed and permissions.may_read(space.fault(fault.id))
    )
    counts = {("warning",): 0, ("error",): 0, ("fatal",): 0, **faults}
    family = GaugeMetricFamily("rosld_faults", "Faults of the robot that last.", labels=("severity",))
    yield _labelled(family, counts.items())
    words = "Time of each command to the robot, by kind and outcome: ok, refused, timeout, failed, cancelled."
    yield _by_operation("command_duration_seconds", words, ("command", "outcome"), session.adapter.timings)
    problems = len(sources.services.problems().storage)
    yield _gauge("storage_problems", "Problems of the storage; /status describes them.", problems)


def _topics(sources: MetricSources, permissions: Permissions) -> Iterator[Metric]:
    session, limit = sources.services.session, sources.services.session.settings.metrics_topics
    topics = [each for each in sorted(session.topics.subscribed()) if permissions.may_read_topic(each)]
    rate = GaugeMetricFamily("rosld_topic_rate_hertz", "Rate of a subscribed topic.", labels=("topic",))
    words = "Time since the last message of a subscribed topic."
    age = GaugeMetricFamily("rosld_topic_last_message_age_seconds", words, labels=("topic",))
    for topic in topics[:limit]:
        view = session.topics.peek(topic)
        if view is None or view.newest is None:
            continue
        age.add_metric((topic,), session.adapter.age_ns(view.newest) / 1e9)
        if view.rate is not None:
            rate.add_metric((topic,), view.rate)
    dropped = sources.services.history.dropped()
    dropped = {topic: count for topic, count in dropped.items() if permissions.may_read_topic(topic)}
    words = "Messages of a topic that could not be recorded."
    lost = CounterMetricFamily("rosld_topic_dropped_messages", words, labels=("topic",))
    yield rate
    yield age
    yield _labelled(lost, (((topic,), dropped[topic]) for topic in sorted(dropped)[:limit]))
    yield _gauge("topics_subscribed", "Topics that rosld subscribes to.", len(topics))
    words = "Subscribed topics beyond the setting metrics_topics, which are left out."
    yield _gauge("topics_omitted", words, max(0, len(topics) - limit))


def _history(sources: MetricSources) -> Iterator[Metric]:
    history = sources.services.history
    yield _gauge("history_enabled", "Whether the history is recorded.", history.is_enabled and history.problem is None)
    yield _gauge("history_size_bytes", "Size of the files of the history.", history.writer.segments.size)
    yield _counter("history_messages", "Messages that were recorded in the history.", history.writer.next)
    words = "Messages that could not be recorded, in the history or in other recordings."
    yield _counter("history_dropped_messages", words, sum(history.dropped().values()))
    yield _gauge(
        "history_queued_bytes",
        "Messages that wait to be recorded.",
        sources.services.recordings.live.recorder.queued_bytes,
    )
