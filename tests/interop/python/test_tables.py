"""Readers of tables: DuckDB, pandas and polars find in served Parquet, Arrow and CSV what rosbags decodes."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from tests.runs import write_run
from tests.server.conftest import servers

NUMBERS = {
    "/odom": ("pose.pose.position.x", "twist.twist.linear.x", "pose.covariance", "header.frame_id", "header.stamp"),
    "/battery_state": ("voltage", "percentage", "present", "power_supply_status", "cell_voltage", "serial_number"),
    "/diagnostics": ("status",),
}


class Run(NamedTuple):
    """A served run, and the values of fields by topic, as rosbags decodes them."""

    http: Any
    folder: Path
    expected: dict[str, dict[str, list[Any]]]

    def file(self, topic: str, format: str) -> Path:
        path = self.folder / f"{topic[1:]}.{format}"
        answer = self.http.get(f"/bags/{self.folder.name}/messages/", params={"topic": topic, "format": format})
        assert answer.status_code == 200, answer.text
        path.write_bytes(answer.content)
        return path


@pytest.fixture(scope="module", params=[".mcap", ".bag"])
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("runs") / "run"
    folder.mkdir()
    path = write_run(folder / f"run{request.param}", seconds=5, seed=3)
    expected: dict[str, dict[str, list[Any]]] = {topic: {"received": []} for topic in NUMBERS}
    with AnyReader([path]) as reader:
        for connection, time_ns, data in reader.messages():
            if connection.topic in NUMBERS:
                message, found = reader.deserialize(data, connection.msgtype), expected[connection.topic]
                found["received"].append(time_ns)
                for name in NUMBERS[connection.topic]:
                    found.setdefault(name, []).append(plain(message, name))
    with servers() as start:
        yield Run(start(str(path)).http, folder, expected)


def plain(value: Any, path: str = "") -> Any:
    """Return the value at a path as Python's own: times in ns."""
    for name in filter(None, path.split(".")):
        value = getattr(value, name)
    if hasattr(value, "nanosec"):
        return value.sec * 10**9 + value.nanosec
    if isinstance(value, list):
        return [plain(each) for each in value]
    if hasattr(value, "__msgtype__"):
        names = [name for name in value.__dataclass_fields__ if name[0].islower()]
        return {name: plain(getattr(value, name)) for name in names}
    return value.tolist() if isinstance(value, np.ndarray) else value


def required(name: str) -> Any:
    return pytest.importorskip(name, reason=f"{name} is not installed: pip install '.[interop]'")


def nanoseconds(values: Any) -> list[int]:
    return [int(each) for each in np.asarray(values, "datetime64[ns]").astype("i8")]


def test_duckdb_reads_parquet(run: Run) -> None:
    duckdb = required("duckdb")
    for topic, expected in run.expected.items():
        file = run.file(topic, "parquet")
        for name, values in expected.items():
            column = f'epoch_ns("{name}")' if name in ("received", "header.stamp") else f'"{name}"'
            rows = duckdb.sql(f"SELECT {column} FROM '{file}' ORDER BY index").fetchall()
            assert [list(each) if isinstance(each, tuple) else each for (each,) in rows] == values, name


def test_pandas_reads_parquet_and_csv(run: Run) -> None:
    pandas = required("pandas")
    for topic, expected in run.expected.items():
        frame, text = pandas.read_parquet(run.file(topic, "parquet")), pandas.read_csv(run.file(topic, "csv"))
        assert list(frame.columns) == list(text.columns)
        for name, values in expected.items():
            if name in ("received", "header.stamp"):
                for column in (frame[name], pandas.to_datetime(text[name])):
                    assert nanoseconds(column.dt.tz_localize(None)) == values
            elif isinstance(values[0], (list, dict)):
                assert [_of_numpy(each) for each in frame[name]] == values
            else:
                assert frame[name].tolist() == values
                assert text[name].astype(frame[name].dtype).tolist() == values


def _of_numpy(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _of_numpy(each) for name, each in value.items()}
    return [_of_numpy(each) for each in value] if isinstance(value, (list, np.ndarray)) else value


def test_polars_reads_parquet_and_arrow(run: Run) -> None:
    polars = required("polars")
    for topic, expected in run.expected.items():
        arrow = polars.read_ipc_stream(io.BytesIO(run.file(topic, "arrow").read_bytes()))
        for frame in (polars.read_parquet(run.file(topic, "parquet")), arrow):
            for name, values in expected.items():
                column = frame[name].dt.timestamp("ns") if name in ("received", "header.stamp") else frame[name]
                assert column.to_list() == values, name
