"""Queries of the past over HTTP: by SPARQL, as a series, at one moment.

Run: python bench/past.py [topics]. The history of a server has an hour of one topic at 50 Hz (Imu, CDR), and a minute
of some other topics. Targets: a second of a topic, or its last message, by SPARQL in 30 ms, the hour of one field as
aggregate in 4 s, as a series of 500 points in 100 ms, `?at=` in 5 ms. For comparison, mcap's reader and rosbags read
and reduce the same hour.
"""

from __future__ import annotations

import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, NamedTuple

import httpx
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

sys.path.insert(0, str(Path(__file__).parents[1]))

from history import IMU, RATE, Messages, by_time

from rosld.adapters.base import AdapterOptions
from rosld.adapters.model import Encoding, Sample
from rosld.adapters.registry import adapter_for
from rosld.server.history.history import FOLDER
from rosld.server.history.history_writer import HistoryWriter
from rosld.server.history.segments import HistoryLimits, Segments
from tests.server.robots.made_up import served

TOPIC = "/sensor_0/imu"
HOUR = 3600
_PREFIXES = (
    "PREFIX ros: <https://w3id.org/rosld#> PREFIX xsd: <http://www.w3.org/2001/XMLSchema#> "
    "PREFIX imu: <https://w3id.org/rosld/types/sensor_msgs/msg/Imu#> "
    "PREFIX vector: <https://w3id.org/rosld/types/geometry_msgs/msg/Vector3#> "
)
_FIELD = "imu:linear_acceleration/vector:z"
Recorded = list[tuple[str, int, bytes]]


def recorded(folder: Path, topics: int, end: int) -> Recorded:
    """Record an hour of one topic, and its last minute of others, in the history of a folder; return the former."""
    writer = HistoryWriter(Segments(folder / FOLDER, HistoryLimits(1e9, 1 << 34)), lambda ref: IMU.definition)
    writer.open()
    messages = Messages(HOUR * RATE + topics * 60 * RATE)
    found: Recorded = []
    written = 0
    for tick in range(HOUR * RATE):
        at = end - (HOUR * RATE - tick) * 20_000_000
        names = [TOPIC, *(f"/sensor_{number}/imu" for number in range(1, topics) if tick >= (HOUR - 60) * RATE)]
        for name in names:
            data = messages.next(at)
            writer.add(name, Sample(data, Encoding.CDR, IMU.ref, "/driver", at, tick))
            if name == TOPIC:
                found.append((TOPIC, at, data))
        if at - written > 1_200_000_000:
            written = at
            writer.write_all()
            writer.write_due(tick / RATE)
    writer.close()
    return found


class Took(NamedTuple):
    """Wall-clock and CPU seconds, including the query process and its workers."""

    wall: float
    processor: float

    def __str__(self) -> str:
        unit, factor = ("s", 1) if self.wall >= 1 else ("ms", 1000)
        return f"{self.wall * factor:.3g} {unit} ({self.processor * factor:.3g} {unit} of a core)"


def processor_seconds() -> float:
    """Return the CPU seconds of this process and its children, including finished ones."""
    return _processor_seconds("self")


def _processor_seconds(pid: str) -> float:
    process = Path("/proc", pid)
    fields = (process / "stat").read_text().rpartition(")")[2].split()
    children = [each for file in process.glob("task/*/children") for each in file.read_text().split()]
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK") + sum(map(_processor_seconds, children))


def timed(ask: Callable[[], Any], rounds: int) -> tuple[Took, Any]:
    """Return the median duration in seconds, the mean CPU seconds, and the result."""
    times: list[float] = []
    found: Any = None
    before = processor_seconds()
    for _ in range(rounds):
        began = time.perf_counter()
        found = ask()
        times.append(time.perf_counter() - began)
    return Took(statistics.median(times), (processor_seconds() - before) / rounds), found


def select(http: httpx.Client, what: str, where: str, modifiers: str = "") -> str:
    """Return the answer to a query, as CSV."""
    query = f"{_PREFIXES}SELECT {what} WHERE {{ {where} }} {modifiers}"
    answer = http.post("/sparql", data={"query": query}, headers={"Accept": "text/csv"})
    assert answer.status_code == 200, answer.text
    return answer.text


def reduce_by_others(path: Path) -> tuple[float, float, float, int]:
    """Return the minimum, maximum and mean of the field, computed with mcap's reader and rosbags."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with path.open("rb") as file:
        values = [
            store.deserialize_cdr(message.data, "sensor_msgs/msg/Imu").linear_acceleration.z
            for _, _, message in make_reader(file).iter_messages(topics=[TOPIC])
        ]
    return min(values), max(values), statistics.fmean(values), len(values)


def moment(time_ns: int) -> str:
    """Return a time as xsd:dateTime."""
    return datetime.fromtimestamp(time_ns // 10**9, timezone.utc).isoformat().replace("+00:00", "Z")


def main() -> int:
    """Print the durations; return 1 if a result differs from that of other readers."""
    topics = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        end = time.time_ns() // 10**9 * 10**9
        messages = recorded(folder / "data", topics, end)
        other = by_time(folder, messages)
        settings = {"data": folder / "data", "history": ("*",), "history_time": 1e9, "history_size": 1 << 34}
        with served(adapter_for("aircraft", AdapterOptions()), query_time_limit=300.0, **settings) as http:
            http.timeout = 300
            good = measure(http, messages, other, end)
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    return int(not good)


def measure(http: httpx.Client, messages: Recorded, other: Path, end: int) -> bool:
    """Run all queries; return whether the results for the hour equal those of other readers."""
    past = f"<{http.base_url}topics{TOPIC}> ros:past ?m . ?m ros:received ?t ; {_FIELD} ?z ."
    begin, until = moment(end - 1800 * 10**9), moment(end - 1799 * 10**9)
    second = f'FILTER(?t >= "{begin}"^^xsd:dateTime && ?t < "{until}"^^xsd:dateTime)'
    took, text = timed(lambda: select(http, "?t ?z", f"{past} {second}"), 15)
    print(f"one second of one topic by SPARQL: {took}, {len(text.splitlines()) - 1} rows")
    took, text = timed(lambda: select(http, "?t ?z", f"{past}", "ORDER BY DESC(?t) LIMIT 1"), 15)
    print(f"the last message of the hour by SPARQL, ORDER BY and LIMIT: {took}, {text.splitlines()[1].split(',')[0]}")
    hour = f'FILTER(?t >= "{moment(end - HOUR * 10**9)}"^^xsd:dateTime)'
    what = "(MIN(?z) AS ?least) (MAX(?z) AS ?most) (AVG(?z) AS ?mean) (COUNT(*) AS ?n)"
    took, text = timed(lambda: select(http, what, f"{past} {hour}"), 3)
    least, most, mean, count = map(float, text.splitlines()[1].split(","))
    others, expected = timed(lambda: reduce_by_others(other), 1)
    print(f"one hour of one field by SPARQL: {took}, {count:.0f} messages; mcap's reader and rosbags {others}")
    series = (
        f"/topics{TOPIC}?series=linear_acceleration.z&points=500&from={moment(end - HOUR * 10**9)}&to={moment(end)}"
    )
    first, _ = timed(lambda: http.get(series, headers={"Accept": "text/csv"}).raise_for_status(), 1)
    took, _ = timed(lambda: http.get(series, headers={"Accept": "text/csv"}).raise_for_status(), 9)
    print(f"the hour as a series of 500 points: {took}, the first time {first}")
    places = iter(range(1, 10**6))

    def at() -> httpx.Response:
        when = moment(messages[(next(places) * 7919) % len(messages)][1])
        return http.get(f"/topics{TOPIC}?at={when}", headers={"Accept": "application/json"}).raise_for_status()

    took, _ = timed(at, 200)
    print(f"?at= of a moment of the hour: {took}")
    return (least, most, count) == (expected[0], expected[1], expected[3]) and abs(mean - expected[2]) < 1e-9


if __name__ == "__main__":
    sys.exit(main())
