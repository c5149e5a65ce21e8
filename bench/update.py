"""SPARQL updates that publish to a real rospy subscriber, compared to a plain PUT of the same message, in one run.

Run: python bench/update.py [seconds]. Needs `wrk` and ROS 1 (Debian: apt-get install wrk ros-core python3-rospy). The
targets are 1,000 updates per second on sixteen connections, and 20 ms for 99 of 100 at 100 per second.
"""

from __future__ import annotations

import http.client
import itertools
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

import httpx
from ros1_ingest import rosmaster
from web import ROUNDS, Rate, measure, serving

TOPIC = "/bench/words"
STRING = "https://w3id.org/rosld/types/std_msgs/msg/String"
PER_SECOND = 100
SUBSCRIBER = f"""
import sys, time, rospy
from std_msgs.msg import String

def heard(message):
    print(time.time_ns(), message.data, flush=True)

rospy.init_node("bench_subscriber")
rospy.Subscriber("{TOPIC}", String, heard, queue_size=100000, tcp_nodelay=True)
print("ready", flush=True)
rospy.spin()
"""
UPDATE = (
    "DELETE {{ GRAPH <{graph}> {{ ?m <{string}#data> ?old }} }} "
    "INSERT {{ GRAPH <{graph}> {{ ?m <{string}#data> '{words}' }} }} "
    "WHERE {{ GRAPH <{graph}> {{ ?m <{string}#data> ?old }} }}"
)
PUT = "<#message> a <{string}> ; <{string}#data> '{words}' ."
SCRIPT = """
local number = 0
local headers = {{ ["Content-Type"] = "{media_type}" }}
request = function()
  number = number + 1
  return wrk.format("{method}", nil, headers, (string.gsub([[{body}]], "WORDS", "w" .. number)))
end
"""


class Way(NamedTuple):
    """A way to publish: a request whose `body` is made from the text to publish."""

    name: str
    method: str
    url: str
    media_type: str
    body: Callable[[str], str]

    def script(self, folder: Path) -> Path:
        """Return a script for wrk that publishes a different text with each request."""
        path = folder / f"{self.method.lower()}.lua"
        path.write_text(SCRIPT.format(method=self.method, media_type=self.media_type, body=self.body("WORDS")))
        return path


class Subscriber:
    """A rospy node, and the times when it received texts (seconds since 1970)."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.heard: dict[str, float] = {}
        self.number = 0
        self._process = process
        self._happened = threading.Condition()
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            moment, _, words = line.strip().partition(" ")
            with self._happened:
                self.heard[words] = int(moment) / 1e9
                self.number += 1
                self._happened.notify_all()

    def wait_for(self, words: str, timeout: float = 10.0) -> None:
        """Wait until it has received a text."""
        with self._happened:
            if not self._happened.wait_for(lambda: words in self.heard, timeout):
                raise SystemExit(f"the subscriber never heard {words!r}")


@contextmanager
def subscriber(master: str, folder: Path) -> Iterator[Subscriber]:
    """Run a real rospy subscriber until it is ready."""
    environment = {
        "ROS_MASTER_URI": master,
        "ROS_HOME": str(folder),
        "ROS_IP": "127.0.0.1",
        "PATH": "/usr/bin:/bin",
    }
    command = ["/usr/bin/python3", "-c", SUBSCRIBER]
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        if process.stdout.readline().strip() != "ready":
            raise SystemExit("rospy did not start")
        yield Subscriber(process)
    finally:
        process.terminate()
        process.wait(10)


def ways(rosld: str) -> tuple[Way, Way]:
    """Return an update and a PUT."""
    graph = f"{rosld}topics{TOPIC}"

    def update(words: str) -> str:
        return UPDATE.format(graph=graph, string=STRING, words=words)

    def put(words: str) -> str:
        return PUT.format(string=STRING, words=words)

    return (
        Way("update", "POST", f"{rosld}sparql", "application/sparql-update", update),
        Way("PUT", "PUT", graph, "text/turtle", put),
    )


class Delay(NamedTuple):
    """Seconds from sending to the response, and to the subscriber's callback."""

    answer: list[float]
    heard: list[float]


def delays(way: Way, hears: Subscriber, seconds: int, turn: int) -> Delay:
    """Send requests in sequence, a hundred per second, on one connection."""
    where = urlsplit(way.url)
    connection = http.client.HTTPConnection(where.hostname or "", where.port or 80)
    sent: dict[str, float] = {}
    answers = []
    begin = time.monotonic()
    for number in range(seconds * PER_SECOND):
        wait = begin + number / PER_SECOND - time.monotonic()
        if wait > 0:
            time.sleep(wait)
        words = f"{way.method}{turn}.{number}"
        body = way.body(words).encode()
        sent[words], since = time.time(), time.perf_counter()
        connection.request(way.method, where.path, body, {"Content-Type": way.media_type})
        answer = connection.getresponse()
        answer.read()
        answers.append(time.perf_counter() - since)
        if answer.status != 204:
            raise SystemExit(f"{way.name} was answered {answer.status}")
    hears.wait_for(words)
    connection.close()
    return Delay(answers, [hears.heard[words] - moment for words, moment in sent.items() if words in hears.heard])


def _at(share: float, found: list[float]) -> float:
    return sorted(found)[min(len(found) - 1, int(share * len(found)))] * 1000


def rates(found: tuple[Way, Way], seconds: int, folder: Path) -> None:
    """Print requests per second on sixteen connections."""
    print(f"{'sixteen connections':28}{'requests':>10}{'of PUT':>9}")
    measured: dict[str, list[Rate]] = {way.name: [] for way in found}
    for _ in range(ROUNDS):
        for way in found:
            measured[way.name].append(measure(way.url, seconds, "-s", str(way.script(folder))))
    for name, each in measured.items():
        ratio = statistics.median(
            one.per_second / other.per_second for one, other in zip(each, measured["PUT"], strict=True)
        )
        failures = sum(one.failures for one in each)
        told = f"  {failures} failed" if failures else ""
        print(f"  {name:26}{statistics.median(one.per_second for one in each):8.0f}/s{ratio:9.2f}{told}")


def latencies(found: tuple[Way, Way], hears: Subscriber, seconds: int) -> None:
    """Print the latencies in milliseconds at a hundred requests per second."""
    measured: dict[str, Delay] = {way.name: Delay([], []) for way in found}
    turns = itertools.count()
    for _ in range(ROUNDS):
        for way in found:
            answers, heard = delays(way, hears, seconds, next(turns))
            measured[way.name].answer.extend(answers)
            measured[way.name].heard.extend(heard)
    print(f"{'100 a second, milliseconds':28}{'p50':>8}{'p99':>8}{'of PUT':>9}{'heard p50':>12}{'p99':>8}{'of PUT':>9}")
    base = measured["PUT"]
    for name, each in measured.items():
        line = f"  {name:26}"
        for times, theirs, width in ((each.answer, base.answer, 8), (each.heard, base.heard, 12)):
            ratio = _at(0.5, times) / _at(0.5, theirs)
            line += f"{_at(0.5, times):{width}.1f}{_at(0.99, times):8.1f}{ratio:9.2f}"
        print(line)


def main() -> None:
    """Print the tables."""
    if shutil.which("wrk") is None or not Path("/usr/bin/rosmaster").exists():
        raise SystemExit("bench/update.py needs wrk and ROS 1: apt-get install wrk ros-core python3-rospy")
    seconds = int(sys.argv[1]) if len(sys.argv) > 1 else 4
    with (
        tempfile.TemporaryDirectory() as folder,
        rosmaster() as master,
        subscriber(master, Path(folder)) as hears,
        serving(
            "-m", "rosld", "serve", master.replace("http:", "ros1:"), "--port", "0", "--max-publish-rate", "1000000000"
        ) as rosld,
    ):
        found = ways(rosld)
        _until_heard(found[1], hears)
        rates(found, seconds, Path(folder))
        latencies(found, hears, seconds)


def _until_heard(way: Way, hears: Subscriber) -> None:
    """Publish until the subscriber receives it, as rosld and the subscriber need some time to discover each other."""
    until = time.monotonic() + 30
    headers = {"Content-Type": way.media_type}
    while not hears.heard:
        httpx.put(way.url, content=way.body("first"), headers=headers)
        if time.monotonic() > until:
            raise SystemExit("the subscriber never heard of rosld")
        time.sleep(0.1)


if __name__ == "__main__":
    main()
