"""Cost of recording: rosld's history compared to `rosbag record`, for the same topics of one rosmaster, in sequence.

Run: python bench/bag_recorders.py [seconds]. A rospy node publishes Imu messages with noise on 200 topics at 50 Hz. The
table has the share of a core that each recorder used (its process and its children), and the bytes of its files per
message: for `rosbag record --lz4`, and for `rosld serve`, with a history and without.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).parents[1]))

from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from tests.adapters.ros1 import system as ros1

TOPICS, RATE = 200, 50
TICKS = os.sysconf("SC_CLK_TCK")
DRIVER = f"""
import random, rospy
from sensor_msgs.msg import Imu
rospy.init_node("driver")
to = [rospy.Publisher("/sensor_%d/imu" % i, Imu, queue_size=100) for i in range({TOPICS})]
some = []
for _ in range(2000):
    one = Imu()
    one.header.frame_id = "imu_link"
    for of, names in ((one.orientation, "xyzw"), (one.angular_velocity, "xyz"), (one.linear_acceleration, "xyz")):
        for name in names:
            setattr(of, name, round(random.gauss(0, 1), 6))
    some.append(one)
print("ready", flush=True)
rate, at = rospy.Rate({RATE}), 0
while not rospy.is_shutdown():
    for each in to:
        at += 1
        each.publish(some[at % 2000])
    rate.sleep()
"""


class Cost(NamedTuple):
    """The share of a core, the numbers of dropped and recorded messages, and their bytes on disk."""

    share: float
    dropped: int
    messages: int
    size: int


@contextmanager
def process(command: Sequence[str], environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """A process that is interrupted at the end, as by Ctrl-C, and awaited."""
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as started:
        try:
            yield started
        finally:
            started.send_signal(signal.SIGINT)
            try:
                started.wait(30)
            except subprocess.TimeoutExpired:
                started.kill()


def seconds_of_core(pid: int) -> float:
    """Return the CPU seconds of a process and its children, including finished ones."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    own = sum(map(int, fields[11:15])) / TICKS
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return own + sum(map(seconds_of_core, map(int, children)))


def share(pid: int, seconds: float) -> float:
    """Return the share of a core that a process uses over some seconds, after some seconds of warm-up."""
    time.sleep(5)
    before, began = seconds_of_core(pid), time.monotonic()
    time.sleep(seconds)
    return (seconds_of_core(pid) - before) / (time.monotonic() - began)


def count(path: Path) -> int:
    """Return the number of messages in a recording according to rosbags and mcap's reader."""
    if path.suffix == ".mcap":
        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
        return 0 if summary is None or summary.statistics is None else summary.statistics.message_count
    with AnyReader([path]) as reader:
        return int(reader.message_count)


def dropped_messages(base: str) -> int:
    """Return the number of dropped messages that the history of a server reports."""
    asked = urllib.request.Request(f"{base}bags/history/", headers={"Accept": "application/n-triples"})
    with urllib.request.urlopen(asked, timeout=30) as answer:
        text = answer.read().decode()
    return sum(int(each) for each in re.findall(r"rosld#dropped[A-Za-z]*> \"(\d+)\"", text))


def rosbag(system: ros1.RosSystem, folder: Path, seconds: float) -> Cost:
    """Run Debian's `rosbag record` on all topics."""
    command = ["/usr/lib/rosbag/record", "--lz4", "--buffsize=0", "-O", str(folder / "all.bag"), "-e", "/sensor_.*"]
    with process(command, system.environment) as recorder:
        taken = share(recorder.pid, seconds)
    files = sorted(folder.glob("*.bag"))
    return Cost(taken, 0, sum(map(count, files)), sum(each.stat().st_size for each in files))


def rosld(system: ros1.RosSystem, folder: Path, seconds: float, *options: str) -> Cost:
    """Run a server with these options."""
    command = [sys.executable, "-m", "rosld", "serve", system.source, "--port", "0", "--data", str(folder), *options]
    with process(command, dict(os.environ)) as server:
        assert server.stdout is not None
        base = server.stdout.readline().strip()
        taken = share(server.pid, seconds)
        dropped = dropped_messages(base) if options else 0
    files = sorted((folder / "history").glob("*.mcap"))
    return Cost(taken, dropped, sum(map(count, files)), sum(each.stat().st_size for each in files))


def main() -> None:
    """Print the table."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
    with (
        tempfile.TemporaryDirectory() as name,
        ros1.running(Path(name) / "ros") as system,
        process([ros1.PYTHON, "-c", DRIVER], system.environment) as driver,
    ):
        assert driver.stdout is not None
        assert driver.stdout.readline().strip() == "ready"
        costs = {
            "rosbag record --lz4": rosbag(system, _made(name, "rosbag"), seconds),
            "rosld, no history": rosld(system, _made(name, "idle"), seconds),
            "rosld --history": rosld(system, _made(name, "rosld"), seconds, "--history", "/sensor_*"),
        }
    print(f"{'':24}{'core':>8}{'messages':>12}{'dropped':>10}{'bytes each':>12}")
    for what, cost in costs.items():
        each = cost.size / cost.messages if cost.messages else 0.0
        print(f"{what:24}{cost.share:8.2f}{cost.messages:12}{cost.dropped:10}{each:12.1f}", flush=True)


def _made(folder: str, name: str) -> Path:
    made = Path(folder) / name
    made.mkdir()
    return made


if __name__ == "__main__":
    main()
