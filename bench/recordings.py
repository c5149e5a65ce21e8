"""Questions over many recordings: SPARQL from statistics, and DuckDB over Parquet files of the same runs.

Run: python bench/recordings.py [runs]. Each run has a minute of odometry, imu, battery, commands and diagnostics.
Targets for 200 runs: the least battery of each in 50 ms, the largest speed of each in at most 5 times DuckDB's time;
for 1,000 runs the least battery of each in 100 ms. The server opens no file for these; `rosld index` is measured, too.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import duckdb
import httpx
import pyarrow
import pyarrow.parquet
from click.testing import CliRunner

sys.path.insert(0, str(Path(__file__).parents[1]))

from rosld.server.cli.main import main as rosld
from tests import runs
from tests.serving_thread import ServingThread

SECONDS = 60
_PREFIXES = (
    "PREFIX battery: <https://w3id.org/rosld/types/sensor_msgs/msg/BatteryState#> "
    "PREFIX odom: <https://w3id.org/rosld/types/nav_msgs/msg/Odometry#> "
    "PREFIX moving: <https://w3id.org/rosld/types/geometry_msgs/msg/TwistWithCovariance#> "
    "PREFIX twist: <https://w3id.org/rosld/types/geometry_msgs/msg/Twist#> "
    "PREFIX vector: <https://w3id.org/rosld/types/geometry_msgs/msg/Vector3#> "
)
_BATTERY = "</topics/battery_state> ros:past ?m . ?m ros:recordedIn ?bag ; battery:percentage ?x"
_SPEED = "</topics/odom> ros:past ?m . ?m ros:recordedIn ?bag ; odom:twist/moving:twist/twist:linear/vector:x ?x"
QUESTIONS = {
    "least battery of each run": (
        f"SELECT ?bag (MIN(?x) AS ?found) {{ {_BATTERY} }} GROUP BY ?bag",
        "SELECT run, min(x) FROM 'battery/*.parquet' GROUP BY run",
    ),
    "largest speed of each run": (
        f"SELECT ?bag (MAX(?x) AS ?found) {{ {_SPEED} }} GROUP BY ?bag",
        "SELECT run, max(x) FROM 'speed/*.parquet' GROUP BY run",
    ),
    "mean speed and number of messages of each run": (
        f"SELECT ?bag (AVG(?x) AS ?found) (COUNT(*) AS ?n) {{ {_SPEED} }} GROUP BY ?bag",
        "SELECT run, avg(x), count(*) FROM 'speed/*.parquet' GROUP BY run",
    ),
    "runs whose battery was below 0.4": (
        f"SELECT DISTINCT ?bag {{ {_BATTERY} FILTER(?x < 0.4) }}",
        "SELECT DISTINCT run FROM 'battery/*.parquet' WHERE x < 0.4",
    ),
}


def write(folder: Path, number: int) -> None:
    """Write a run, and its charges and speeds as Parquet."""
    name = f"run{number:04}"
    start = runs.START_NS + number * 3_600_000_000_000
    runs.write_run(folder / "runs" / f"{name}.mcap", seconds=SECONDS, seed=number, start_ns=start)
    charges, speeds = list[float](), list[float]()
    for each in runs.spoken(2, SECONDS, number, start):
        if each.topic == "/battery_state":
            charges.append(each.message.percentage)
        elif each.topic == "/odom":
            speeds.append(each.message.twist.twist.linear.x)
    for topic, values in (("battery", charges), ("speed", speeds)):
        table = pyarrow.table({"run": [name] * len(values), "x": values})
        pyarrow.parquet.write_table(table, folder / topic / f"{name}.parquet")


def seconds(work: Callable[[], object], turns: int = 9) -> float:
    """Return the median duration of some work after a first turn."""
    work()
    times = []
    for _ in range(turns):
        begun = time.perf_counter()
        work()
        times.append(time.perf_counter() - begun)
    return statistics.median(times)


def main(count: int = 200) -> None:
    with tempfile.TemporaryDirectory() as path:
        folder = Path(path)
        for name in ("runs", "battery", "speed"):
            (folder / name).mkdir()
        for number in range(count):
            write(folder, number)
        begun = time.perf_counter()
        indexed = CliRunner().invoke(rosld, ["index", str(folder / "runs")])
        assert indexed.exit_code == 0, indexed.output
        print(f"rosld index of {count} runs of {SECONDS} s: {time.perf_counter() - begun:.1f} s")
        server = ServingThread.of_command(str(folder / "runs"), "--port", "0")
        http = httpx.Client(base_url=server.url(), timeout=60, headers={"Accept": "text/csv"})
        for title, (sparql, sql) in QUESTIONS.items():
            rows: list[int] = []

            def ask(sparql: str = sparql, rows: list[int] = rows) -> None:
                answer = http.post("/sparql", data={"query": _PREFIXES + sparql})
                assert answer.status_code == 200, answer.text
                rows.append(answer.text.count("\n") - 1)

            duck = sql.replace("FROM '", f"FROM '{folder}/")
            expected = len(duckdb.sql(duck).fetchall())
            ours, theirs = seconds(ask), seconds(lambda duck=duck: duckdb.sql(duck).fetchall())
            assert rows[0] == expected, (rows[0], expected)
            print(f"{title}: {ours * 1000:.0f} ms; DuckDB {theirs * 1000:.0f} ms; {ours / theirs:.1f} times")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
