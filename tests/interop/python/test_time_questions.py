"""pandas answers the questions of `docs/how-to/time.md` as the server does."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from tests.runs import START_NS, write_run
from tests.server.conftest import servers

pd = pytest.importorskip("pandas", reason="pandas is not installed: pip install '.[interop]'")

TEXT = (Path(__file__).parents[3] / "docs" / "how-to" / "time.md").read_text("utf-8")
PREFIXES = TEXT.partition("```text\n")[2].partition("```")[0]
QUESTION = re.compile(r"^\*\*(\d+)\. .*?```sparql\n(.*?)```", re.DOTALL | re.MULTILINE)
QUESTIONS = {int(number): query for number, query in QUESTION.findall(TEXT)}
SECONDS = 80
"""Long enough for the battery to become low."""
WINDOW = 10 * 10**9
FIELDS: dict[str, dict[str, Callable[[Any], Any]]] = {
    "/odom": {
        "stamp": lambda m: m.header.stamp.sec * 10**9 + m.header.stamp.nanosec - START_NS,
        "x": lambda m: m.pose.pose.position.x,
        "y": lambda m: m.pose.pose.position.y,
        "speed": lambda m: m.twist.twist.linear.x,
        "wheels": lambda m: m.twist.twist.angular.z,
    },
    "/imu": {"rate": lambda m: m.angular_velocity.z},
    "/battery_state": {"charge": lambda m: float(str(np.float32(m.percentage)))},
    "/cmd_vel": {"wanted": lambda m: m.linear.x},
    "/diagnostics": {"level": lambda m: m.status[0].level},
}


class Run(NamedTuple):
    """A served run, and its topics as data frames."""

    http: Any
    frames: dict[str, Any]

    def ask(self, number: int) -> list[list[float]]:
        """Return the rows of an answer, times in ns since the begin of the run."""
        answer = self.http.post("/sparql", data={"query": PREFIXES + QUESTIONS[number]}, headers={"Accept": "text/csv"})
        assert answer.status_code == 200, answer.text
        rows = list(csv.reader(io.StringIO(answer.text)))[1:]
        return [[pd.Timestamp(each).value - START_NS if "T" in each else float(each) for each in row] for row in rows]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    path = write_run(tmp_path_factory.mktemp("time") / "run.mcap", seconds=SECONDS, seed=4)
    rows: dict[str, list[list[Any]]] = {topic: [] for topic in FIELDS}
    with AnyReader([path]) as reader:
        for connection, time_ns, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            rows[connection.topic].append(
                [time_ns - START_NS, *(read(message) for read in FIELDS[connection.topic].values())]
            )
    frames = {topic[1:]: pd.DataFrame(rows[topic], columns=["t", *FIELDS[topic]]) for topic in FIELDS}
    with servers() as start:
        yield Run(start(str(path)).http, frames)


def expected(frames: dict[str, Any]) -> dict[int, Callable[[], Any]]:
    """Return the answers of pandas by the number of the question; times in ns since the begin of the run."""
    odom, imu, battery, command, report = (
        frames[name] for name in ("odom", "imu", "battery_state", "cmd_vel", "diagnostics")
    )
    windows = odom.t // WINDOW * WINDOW

    def seconds(frame: Any) -> Any:
        return frame.t.diff() / 1e9

    def gaps() -> Any:
        found = pd.DataFrame({"from": odom.t.shift(), "gap": odom.t.diff() / 1e9}).dropna()
        return found.sort_values(["gap", "from"], ascending=[False, True]).head(5)

    def delays() -> Any:
        delay = (odom.t - odom.stamp) / 1e9
        return [[delay.mean(), delay.max(), delay.quantile(0.99)]]

    def joined(left: Any, *others: Any) -> Any:
        for other in others:
            left = pd.merge_asof(left, other, on="t")
        return left.dropna()

    def changes() -> Any:
        found = pd.DataFrame({"t": report.t, "was": report.level.shift(), "level": report.level}).dropna()
        return found[found.was != found.level]

    def states() -> Any:
        spans = pd.DataFrame({"level": report.level.shift(), "seconds": seconds(report)}).dropna()
        return spans.groupby("level", as_index=False).seconds.sum()

    def warning() -> Any:
        first = report[report.level > 0].head(1)[["t"]]
        return joined(first, odom[["t", "x", "y"]], command)

    speed = odom.speed
    return {
        1: lambda: [[odom.t.min(), odom.t.max(), (odom.t.max() - odom.t.min()) / 1e9]],
        2: lambda: odom.groupby(windows).size().reset_index(),
        3: gaps,
        4: delays,
        5: lambda: [[speed.median(), speed.quantile(0.95), speed.max()]],
        6: lambda: odom.loc[[speed.idxmax()], ["t", "speed"]],
        7: lambda: [[imu.rate.mean(), imu.rate.std()]],
        8: lambda: [[(speed > 0.5).sum(), len(speed)]],
        9: lambda: speed.groupby(windows).agg(["mean", "max"]).reset_index(),
        10: lambda: [[np.hypot(odom.x.diff(), odom.y.diff()).sum()]],
        11: lambda: [[(speed.diff() / seconds(odom)).max()]],
        12: lambda: [[(imu.rate * seconds(imu)).sum()]],
        13: lambda: [[seconds(odom)[speed.shift().abs() < 0.05].sum()]],
        14: changes,
        15: states,
        16: lambda: joined(battery, odom[["t", "speed"]]),
        17: lambda: joined(command, odom[["t", "speed"]], imu),
        18: lambda: [[((one := joined(odom, command)).wanted - one.speed).pow(2).mean() ** 0.5]],
        19: lambda: [[((one := joined(odom, imu)).wheels - one.rate).abs().max(), len(one)]],
        20: warning,
    }


def test_pandas_answers_every_question_as_the_server_does(run: Run) -> None:
    answers = expected(run.frames)
    assert list(QUESTIONS) == list(answers) == list(range(1, 21))
    for number, answer in answers.items():
        rows = answer()
        wanted = rows if isinstance(rows, list) else rows.to_numpy().tolist()
        found = run.ask(number)
        assert len(found) == len(wanted) > 0, number
        for row, other in zip(found, wanted, strict=True):
            assert row == pytest.approx([float(each) for each in other], rel=1e-9, abs=1e-9), number
