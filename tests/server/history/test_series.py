"""The past of a topic: series of a number, and its former states, compared to its messages read by third parties."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from datetime import datetime, timedelta, timezone
from email.utils import format_datetime
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from pyarrow import parquet

from tests.server.history.mcap_files import decode, read
from tests.waiting import until

pytestmark = pytest.mark.slow

JSON = {"Accept": "application/json"}
NTRIPLES = {"Accept": "application/n-triples"}
FIELD = "header.stamp.nanosec"


class Past(NamedTuple):
    """A rover with a past: its client, and its odometry read by third parties: times in ns, and the field's numbers."""

    http: Any
    times: list[int]
    values: list[float]


@pytest.fixture(scope="module")
def past(start_server: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Past:
    """A few seconds of a rover, downloaded as a file."""
    folder = tmp_path_factory.mktemp("past")
    http = start_server("rover", "--history", "/odom", "--data", str(folder / "data")).http
    until(
        lambda: '"2' in http.get("/topics/odom?series=twist.twist.linear.x&points=10000", headers=JSON).text, "a past"
    )
    until(lambda: len(columns(http, f"series={FIELD}&points=10000")["time"]) > 60, "a longer past")
    http.post("/bags/", json={"name": "all", "topics": ["/odom"], "before": 3600})
    content = '{"status": "ended"}'
    http.patch("/bags/all/", content=content, headers={"Content-Type": "application/merge-patch+json"})
    file: Path = folder / "all.mcap"
    file.write_bytes(http.get("/bags/all/file").content)
    found: list[tuple[int, float]] = []
    messages = sorted(read(file), key=lambda one: one.time_ns)
    decoded: list[Any] = [message for _, message in decode(file)]
    found = [(one.time_ns, float(each.header.stamp.nanosec)) for one, each in zip(messages, decoded, strict=True)]
    return Past(http, [at for at, _ in found], [value for _, value in found])


def columns(http: Any, query: str) -> Any:
    answer = http.get(f"/topics/odom?{query}", headers=JSON)
    assert answer.status_code == 200, answer.text
    return answer.json()


def moment(time_ns: int) -> str:
    """Return a time as xsd:dateTime; to the microsecond, the precision of datetime."""
    at = datetime.fromtimestamp(time_ns // 10**9, timezone.utc) + timedelta(microseconds=time_ns % 10**9 // 1000)
    return at.isoformat().replace("+00:00", "Z")


def window(past: Past) -> str:
    """Return the interval from the first to the last message."""
    return f"from={moment(past.times[0])}&to={moment(past.times[-1] + 1000)}"


def test_a_series_of_few_messages_has_each(past: Past) -> None:
    found = columns(past.http, f"series={FIELD}&points=10000&{window(past)}")
    assert found["value"] == past.values
    assert [each[:26] for each in found["time"]] == [moment(at)[:-1].ljust(26, "0") for at in past.times]


def test_a_series_of_many_is_reduced_and_comes_to_what_the_messages_do(past: Past) -> None:
    for points in (1, 7, 40):
        reduces(past, points)


def reduces(past: Past, points: int) -> None:
    begin, end = past.times[0] // 1000 * 1000, (past.times[-1] + 1000) // 1000 * 1000
    expected: dict[int, list[float]] = {}
    for at, value in zip(past.times, past.values, strict=True):
        expected.setdefault(min((at - begin) * points // (end - begin), points - 1), []).append(value)
    for _ in range(2):  # the second time from the index
        found = columns(past.http, f"series={FIELD}&points={points}&{window(past)}")
        assert found["count"] == [len(expected[each]) for each in sorted(expected)]
        assert found["min"] == [min(expected[each]) for each in sorted(expected)]
        assert found["max"] == [max(expected[each]) for each in sorted(expected)]
        means = [sum(expected[each]) / len(expected[each]) for each in sorted(expected)]
        assert found["mean"] == pytest.approx(means)


def test_a_series_comes_as_csv_and_as_rdf(past: Past) -> None:
    query = f"series={FIELD}&points=5&{window(past)}"
    table = columns(past.http, query)
    for how in ({"Accept": "text/csv"}, {}):
        answer = past.http.get(f"/topics/odom?{query}{'' if how else '&format=csv'}", headers=how)
        assert answer.headers["content-type"].startswith("text/csv")
        rows = list(csv.DictReader(answer.text.splitlines()))
        assert [int(row["count"]) for row in rows] == table["count"]
        assert [float(row["mean"]) for row in rows] == table["mean"]
    text = past.http.get(f"/topics/odom?{query}", headers=NTRIPLES).text
    assert text.count("rosld#meanValue>") == len(table["time"])
    assert "rosld#seriesOf>" in text


NO_PAST = {
    400: ("series=", f"series={FIELD}&points=0", f"series={FIELD}&points=x", f"series={FIELD}&from=yesterday",
          f"series={FIELD}&from=-1e400", f"series={FIELD}&from=-1e30&to=-1e29", "at=now"),
    404: ("series=header.frame_id", "series=header", "at=0001-01-01T00:00:00Z", "at=-1e30"),
}  # fmt: skip


def test_several_series_are_columns_of_one_table(past: Past) -> None:
    for points in (10000, 7):
        query = f"from={moment(past.times[0] - 1000)}&to={moment(past.times[-1] + 1000)}&points={points}"
        other = "twist.twist.linear.x"
        one, two = (columns(past.http, f"series={field}&{query}") for field in (FIELD, other))
        both = columns(past.http, f"series={FIELD}&series={other}&{query}")
        assert (both["fields"], both["units"]) == ([FIELD, other], {FIELD: one["unit"], other: "m/s"})
        assert both["time"] == one["time"] == two["time"]
        names = (
            {FIELD: "value"} if points > 7 else {f"{FIELD}.{each}": each for each in ("min", "max", "mean", "count")}
        )
        for name, each in names.items():
            assert (both[name], both[name.replace(FIELD, other)]) == (one[each], two[each])
        rows = [
            *csv.DictReader(
                past.http.get(f"/topics/odom?series={FIELD}&series={other}&{query}&format=csv").text.splitlines()
            )
        ]
        assert [float(row[next(iter(names))]) for row in rows] == both[next(iter(names))]
        file = past.http.get(f"/topics/odom?series={FIELD}&series={other}&{query}&format=parquet").content
        table = parquet.read_table(io.BytesIO(file))
        assert table.schema.names == [name for name in both if name not in ("topic", "fields", "units")]
        assert table.schema[-1 if points > 7 else -2].metadata[b"unit"].endswith(b"M-PER-SEC")
        assert {name: table[name].to_pylist() for name in names} == {name: both[name] for name in names}
    refused = past.http.get(f"/topics/odom?series={FIELD}&series={other}", headers={"Accept": "text/turtle"})
    assert (refused.status_code, "text/csv" in refused.text) == (406, True)


def test_a_past_that_cannot_be_read_is_refused_with_what_there_is_instead(past: Past) -> None:
    for status, queries in NO_PAST.items():
        for query in queries:
            answer = past.http.get(f"/topics/odom?{query}", headers=JSON)
            assert (answer.status_code, len(answer.json()["detail"]) > 20) == (status, True), query
    for path, words in (
        ("odom?series=twist.nothing", "has no field 'twist.nothing' here; numeric fields are header.stamp.sec, "),
        ("odom?series=twist.twist", "is not a number; numeric fields are twist.twist.linear.x, twist.twist.linear.y, "),
        ("odom?series=pose.covariance", "is not a number: name an element, such as pose.covariance.0."),
        (f"odom?series={FIELD}&from=-1&to=-2", "?from=-1 is not before ?to=-2."),
        (f"odom?series={FIELD}&to=-120", "by default a minute ago, is not before ?to=-120."),
        ("odom?at=1990-01-01T00:00:00Z", "until 1990-01-01T00:00:00Z: the history begins at 20"),
        ("imu?at=-1", "start rosld with --history /imu, or --history '*' for all topics."),
        ("imu?series=angular_velocity.x", "--history"),
        ("odm?at=-1", "There is no topic /odm."),
        ("odm?series=x", "There is no topic /odm."),
        ("odm?timemap", "There is no topic /odm."),
    ):
        problem = past.http.get(f"/topics/{path}", headers=JSON).json()
        assert words in problem["detail"], path
        assert ("odm" in path) == (f"{past.http.base_url}topics/odom" in problem.get("near", ()))


def test_times_before_and_after_all_messages_are_as_good_as_any(past: Past) -> None:
    for long_ago in ("-1e30", "0001-01-01T00:00:00Z"):
        found = columns(past.http, f"series={FIELD}&points=1&from={long_ago}")
        assert found["count"][0] >= len(past.times)
        page = past.http.get(f"/bags/history/messages/?from={long_ago}&to=9999-12-31T23:59:59Z&limit=1", headers=JSON)
        assert [one["index"] for one in page.json()["messages"]] == [0]
        assert past.http.get(f"/bags/history/at?time={long_ago}", headers=JSON).json()["messages"] == []
        resource = past.http.get(f"/resources/odom?at={long_ago}", headers=NTRIPLES)
        assert resource.status_code < 500, resource.text
    for answer in (columns(past.http, "at=9999-12-31T23:59:59Z"), columns(past.http, "at=2400-01-01T00:00:00")):
        assert answer["child_frame_id"] == "base_link"


def test_a_topic_is_as_it_was_and_says_when_that_was(past: Past) -> None:
    middle = len(past.times) // 2
    last = f"/topics/odom?at={moment(past.times[-1] + 1000)}"
    until(lambda: "memento-datetime" in past.http.get(last, headers=JSON).headers, "the last moment to be settled")
    until(
        lambda: past.http.get(f"/topics/odom?at={moment(past.times[-1])}", headers=JSON).status_code == 200, "the past"
    )
    for number in (0, middle, len(past.times) - 1):
        answer = past.http.get(f"/topics/odom?at={moment(past.times[number] + 1000)}", headers=JSON)
        assert answer.json()["header"]["stamp"]["nanosec"] == past.values[number]
        at = datetime.fromtimestamp(past.times[number] // 10**9, timezone.utc)
        assert answer.headers["memento-datetime"] == format_datetime(at, usegmt=True)
        assert f'<{past.http.base_url}topics/odom>; rel="original"' in answer.headers["link"]
    text = past.http.get(f"/topics/odom?at={moment(past.times[0] + 1000)}", headers=NTRIPLES).text
    assert f'"{int(past.values[0])}"' in text
    assert past.http.put("/topics/odom?at=2030-01-01T00:00:00Z", json={}).status_code == 405
    later = past.http.get(f"/topics/odom?at={moment(past.times[-1] + 10**15)}", headers=JSON)
    assert "memento-datetime" not in later.headers, "it may still change"
