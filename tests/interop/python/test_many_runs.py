"""DuckDB over Parquet, decoded by rosbags, finds the same numbers in many recordings as SPARQL over HTTP."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import duckdb
import pyarrow
import pyarrow.parquet
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from tests import runs

pytestmark = pytest.mark.slow

PREFIXES = (
    "PREFIX battery: <https://w3id.org/rosld/types/sensor_msgs/msg/BatteryState#> "
    "PREFIX odom: <https://w3id.org/rosld/types/nav_msgs/msg/Odometry#> "
    "PREFIX moving: <https://w3id.org/rosld/types/geometry_msgs/msg/TwistWithCovariance#> "
    "PREFIX twist: <https://w3id.org/rosld/types/geometry_msgs/msg/Twist#> "
    "PREFIX vector: <https://w3id.org/rosld/types/geometry_msgs/msg/Vector3#> "
)
FIELDS = {
    "/battery_state": ("battery:percentage", lambda each: each.percentage),
    "/odom": ("odom:twist/moving:twist/twist:linear/vector:x", lambda each: each.twist.twist.linear.x),
}


@pytest.mark.parametrize("topic", FIELDS)
def test_duckdb_finds_the_same_numbers(tmp_path: Path, start_server: Callable[..., Any], topic: str) -> None:
    path, value = FIELDS[topic]
    (tmp_path / "runs").mkdir()
    found: dict[str, list[Any]] = {"run": [], "time": [], "x": []}
    for seed in range(6):
        file = runs.write_run(
            tmp_path / "runs" / f"run{seed}{('.mcap', '.db3', '.bag')[seed % 3]}",
            seconds=15 + seed,
            seed=seed,
            start_ns=runs.START_NS + seed * 5_000_000_000,
        )
        with AnyReader([file], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            for connection, time_ns, data in reader.messages():
                if connection.topic == topic:
                    row = (f"run{seed}", time_ns, value(reader.deserialize(data, connection.msgtype)))
                    for name, each in zip(found, row, strict=True):
                        found[name].append(each)
    pyarrow.parquet.write_table(pyarrow.table(found), tmp_path / "all.parquet")
    http = start_server(str(tmp_path / "runs")).http
    for where, condition in {
        "": "",
        'FILTER(?t >= "2023-11-14T22:13:25.5Z"^^xsd:dateTime)': "WHERE time >= 1700000005500000000",
        "FILTER(?x < 0.8)": "WHERE x < 0.8",
        "FILTER(?x < 0.8) OPTIONAL { ?m <urn:nothing> ?nothing }": "WHERE x < 0.8",
    }.items():
        query = (
            f"{PREFIXES} SELECT ?name (COUNT(*) AS ?n) (MIN(?x) AS ?least) (MAX(?x) AS ?most) (SUM(?x) AS ?sum) "
            f"(AVG(?x) AS ?mean) {{ </topics{topic}> ros:past ?m . ?m ros:received ?t ; ros:recordedIn ?bag ; "
            f"{path} ?x . ?bag ros:name ?name {where} }} GROUP BY ?name ORDER BY ?name"
        )
        answer = http.get("/sparql", params={"query": query}, headers={"Accept": "text/csv"})
        assert answer.status_code == 200, answer.text
        rows = [line.split(",") for line in answer.text.splitlines()[1:]]
        sql = f"SELECT run, count(*), min(x), max(x), sum(x), avg(x) FROM '{tmp_path}/all.parquet' {condition}"
        expected = duckdb.sql(f"{sql} GROUP BY run ORDER BY run").fetchall()
        assert [row[0] for row in rows] == [row[0] for row in expected]
        for row, numbers in zip(rows, expected, strict=True):
            assert [float(each) for each in row[1:]] == pytest.approx(numbers[1:], rel=1e-5), (where, row)
