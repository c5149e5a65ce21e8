"""ROS 2: whether the memory of rosld grows beside many topics, looked at now and then.

    python bench/ros2_memory.py --minutes 60 [--topics 200] [--every 5] [--most 20]

A talker publishes on all topics at 50 Hz, and `rosld serve ros2:` serves them. Every few seconds some of the topics are
read over HTTP, some by SPARQL, and the resident memory (RSS) of the server's process is measured. The output is the
memory over time and its growth per hour: the slope of the least-squares line after the warm-up, a third of the time and
five minutes at most. The exit code is 1 if memory grew by more than `--most` MB after the warm-up.

Runs in the venv of `make ros2`, or in a Python with rclpy.
"""

from __future__ import annotations

import argparse
import http.client
import importlib.util
import json
import os
import random
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote, urlsplit

ROOT = Path(__file__).parents[1]
VENV = ROOT / ".venv-ros2-jazzy" / "bin" / "python"
LONGEST_WARM_UP = 300.0
LOOKED_AT = 20
SEEN = 0.5
"""Minimum share of topics with a message at each read."""
MAX_LINES = 60
PATIENCE = 60.0
QUERY = "SELECT ?topic ?rate WHERE { GRAPH <%s> { ?topic <https://w3id.org/rosld#rate> ?rate } }"


class Held(NamedTuple):
    """The memory in use (MB) at a time (seconds since the start)."""

    seconds: float
    megabytes: float


def warm(samples: Sequence[Held]) -> Sequence[Held]:
    """Return the samples after the warm-up."""
    last = samples[-1].seconds
    return [one for one in samples if one.seconds >= min(last / 3, LONGEST_WARM_UP)]


def slope(samples: Sequence[Held]) -> float:
    """Return the slope of the least-squares line in megabytes per second. Raises ValueError if all times are equal."""
    seconds = sum(one.seconds for one in samples) / max(len(samples), 1)
    megabytes = sum(one.megabytes for one in samples) / max(len(samples), 1)
    spread = sum((one.seconds - seconds) ** 2 for one in samples)
    if not spread:
        raise ValueError(f"{len(samples)} samples give no slope: run it for longer")
    return sum((one.seconds - seconds) * (one.megabytes - megabytes) for one in samples) / spread


def grown(samples: Sequence[Held]) -> float:
    """Return the growth of memory after the warm-up in megabytes."""
    after = warm(samples)
    return slope(after) * (after[-1].seconds - after[0].seconds)


def held(process: int) -> float:
    """Return the memory of a process in megabytes."""
    pages = int(Path(f"/proc/{process}/statm").read_text("ascii").split()[1])
    return pages * resource.getpagesize() / 1e6


@contextmanager
def running(command: Sequence[str], domain: int) -> Iterator[subprocess.Popen[str]]:
    """Run a process in a domain, on loopback; end it by its own handle."""
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(5)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait(10)


def line(process: subprocess.Popen[str]) -> str:
    """Return the next line that a process prints."""
    assert process.stdout is not None
    return process.stdout.readline().strip()


class Client:
    """Client of a server, whose first line of output has the URL."""

    def __init__(self, base: str) -> None:
        self._base = base
        self._connection = http.client.HTTPConnection(urlsplit(base).netloc, timeout=PATIENCE)

    def get(self, path: str, accept: str) -> tuple[int, bytes]:
        """Return the status and the body."""
        self._connection.request("GET", path, headers={"Accept": accept})
        answer = self._connection.getresponse()
        return answer.status, answer.read()

    def look(self, number: int) -> bool:
        """Read a topic as a script, as an agent and as a query would; return whether there was a message.

        On a busy machine there may be none within the wait of a first read. Raises RuntimeError if a request fails.
        """
        path = f"/topics/bench/topic_{number}"
        query = QUERY % f"{self._base.rstrip('/')}{path}"
        status, body = self.get(path, "application/json")
        if status != 200:
            raise RuntimeError(f"{path} answers {status}: {body[:200]!r}")
        found = json.loads(body) is not None
        for asked, accept in ((path, "text/turtle"), (f"/sparql?query={quote(query)}", "application/json")):
            status, body = self.get(asked, accept)
            if status != 200:
                raise RuntimeError(f"{asked} answers {status}: {body[:200]!r}")
        return found

    def wait(self, topics: int) -> None:
        """Wait until the last topic exists."""
        until = time.monotonic() + PATIENCE
        while True:
            try:
                if self.look(topics - 1):
                    return
                raise RuntimeError("there is no message on the last topic")
            except RuntimeError:
                if time.monotonic() > until:
                    raise
                time.sleep(0.2)


def measure(options: argparse.Namespace) -> list[Held]:
    """Return the memory of a server over time."""
    domain, chance = options.domain, random.Random(1)
    talker = [sys.executable, str(ROOT / "bench" / "ros2.py"), "--role", "talk", f"--topics={options.topics}"]
    server = [sys.executable, "-m", "rosld", "serve", f"ros2:?domain={domain}", "--port", "0"]
    samples: list[Held] = []
    with running(talker, domain) as talking, running(server, domain) as serving:
        if line(talking) != "ready":
            raise RuntimeError("the talker did not start")
        client = Client(line(serving))
        client.wait(options.topics)
        began = due = time.monotonic()
        while (now := time.monotonic()) < began + options.minutes * 60:
            numbers = chance.sample(range(options.topics), min(LOOKED_AT, options.topics))
            if sum(client.look(number) for number in numbers) < SEEN * len(numbers):
                raise RuntimeError(f"of {len(numbers)} topics hardly any had a message")
            samples.append(Held(now - began, held(serving.pid)))
            due = max(due + options.every, time.monotonic())
            time.sleep(max(0.0, min(due, began + options.minutes * 60) - time.monotonic()))
    return samples


def main() -> int:
    """Measure, print, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--minutes", type=float, required=True)
    parser.add_argument("--topics", type=int, default=200)
    parser.add_argument("--every", type=float, default=5.0, help="seconds from one look to the next")
    parser.add_argument("--most", type=float, default=20.0, help="megabytes that memory may grow after the warm-up")
    parser.add_argument("--domain", type=int, default=random.SystemRandom().randrange(1, 101), help="the ROS domain")
    options = parser.parse_args()
    if importlib.util.find_spec("rclpy") is None:
        if VENV.exists():
            return subprocess.run([str(VENV), __file__, *sys.argv[1:]], check=False).returncode
        print("ros2 memory: skipped, there is no rclpy here (make ros2 makes a venv that has one)")
        return 0
    samples = measure(options)
    for one in samples[:: max(1, len(samples) // MAX_LINES)]:
        print(f"{one.seconds:8.0f} s {one.megabytes:8.1f} MB")
    more, hourly = grown(samples), slope(warm(samples)) * 3600
    print(f"ros2 memory, {options.topics} topics of 50 Hz, {len(samples)} looks: {hourly:+.1f} MB an hour, ", end="")
    print(f"grown by {more:.1f} MB after the warm-up (at most {options.most:g} MB)")
    return 0 if more <= options.most else 1


if __name__ == "__main__":
    sys.exit(main())
