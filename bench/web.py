"""GET and PUT over HTTP, as ratios to a bare Starlette on the same server (uvloop, httptools), in one run.

No two requests are the same, so that each is answered separately.

Run: python bench/web.py [seconds]. Needs `wrk` (Debian: apt-get install wrk).
"""

from __future__ import annotations

import re
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

ROUNDS = 3
BASELINE = """
import socket, uvicorn
from starlette.applications import Starlette
from starlette.responses import Response
from starlette.routing import Route

BODY = b"<#s> <#p> " + b'"x" .' + b"#" * 1009

async def read(request):
    return Response(BODY, media_type="text/turtle")

async def write(request):
    await request.body()
    return Response(status_code=204)

app = Starlette(routes=[Route("/x", read, methods=["GET"]), Route("/x", write, methods=["PUT"])])
sock = socket.socket(); sock.bind(("127.0.0.1", 0))
print(f"http://127.0.0.1:{sock.getsockname()[1]}/", flush=True)
config = uvicorn.Config(app, loop="uvloop", http="httptools", access_log=False, log_level="error")
uvicorn.Server(config).run(sockets=[sock])
"""
ANEW = """
local number = 0
request = function()
  number = number + 1
  wrk.headers["X-Number"] = number
  return wrk.format()
end
"""
"""No two requests are the same."""
PUT = """
local number = 0
request = function()
  number = number + 1
  return wrk.format("PUT", nil, {["Content-Type"] = "text/turtle"}, [[
<#message> a <https://w3id.org/rosld/types/std_msgs/msg/String> ;
  <https://w3id.org/rosld/types/std_msgs/msg/String#data> "climb to ]] .. number .. [[" .]])
end
"""
"""No two messages are the same."""


class Rate(NamedTuple):
    """Results of wrk."""

    per_second: float
    failures: int


@contextmanager
def serving(*command: str) -> Iterator[str]:
    """Run a server as a process; its URL is the first line it prints."""
    process = subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield process.stdout.readline().strip()
    finally:
        process.terminate()
        process.wait(10)


def measure(url: str, seconds: int, *options: str) -> Rate:
    """Return the requests per second on sixteen connections."""
    command = ["wrk", "-t1", "-c16", f"-d{seconds}s", *options, url]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    found = re.search(r"Requests/sec:\s+([\d.]+)", output)
    failed = re.search(r"Non-2xx or 3xx responses: (\d+)", output)
    assert found, output
    return Rate(float(found[1]), int(failed[1]) if failed else 0)


def heading(width: int, other: str) -> None:
    """Print the column headings of `compare`."""
    print(f"{'':{width}}{'rosld/s':>10}{other + '/s':>12}{'ratio':>8}")


def compare(width: int, label: str, ours: str, theirs: str, seconds: int, *options: str) -> None:
    """Print the rates of two servers and their ratio: medians over some rounds."""
    pairs = [(measure(ours, seconds, *options), measure(theirs, seconds, *options)) for _ in range(ROUNDS)]
    ratio = statistics.median(one.per_second / other.per_second for one, other in pairs)
    fast, slow = (statistics.median(pair[at].per_second for pair in pairs) for at in (0, 1))
    failures = sum(each.failures for pair in pairs for each in pair)
    print(f"{label:{width}}{fast:10.0f}{slow:12.0f}{ratio:8.2f}" + (f"  {failures} failed" if failures else ""))


def compare_anew(width: int, label: str, ours: str, theirs: str, seconds: int, *options: str, anew: str = ANEW) -> None:
    """Print the same for unique requests, which the Lua program `anew` creates."""
    with tempfile.NamedTemporaryFile("w", suffix=".lua") as script:
        script.write(anew)
        script.flush()
        compare(width, label, ours, theirs, seconds, *options, "-s", script.name)


def main() -> None:
    """Print the table."""
    if shutil.which("wrk") is None:
        raise SystemExit("bench/web.py needs wrk: apt-get install wrk")
    seconds = int(sys.argv[1]) if len(sys.argv) > 1 else 4
    serve = ("-m", "rosld", "serve", "aircraft", "--port", "0", "--max-publish-rate", "1000000000")
    with serving("-c", BASELINE) as bare, serving(*serve) as rosld:
        speed, aircraft = f"{rosld}topics/aircraft/engine/speed", f"{rosld}resources/aircraft/"
        rows = {
            "GET live topic at 10 Hz, Turtle": (speed, "text/turtle"),
            "GET live topic at 10 Hz, JSON-LD": (speed, "application/ld+json"),
            "GET live topic at 10 Hz, JSON": (speed, "application/json"),
            "GET complex resource, Turtle": (aircraft, "text/turtle"),
            "GET complex resource, JSON": (aircraft, "application/json"),
            "GET property by a getter, JSON": (f"{aircraft}power", "application/json"),
        }
        heading(36, "bare")
        for label, (ours, accept) in rows.items():
            compare_anew(36, label, ours, f"{bare}x", seconds, "-H", f"Accept: {accept}")
        compare_anew(36, "PUT that publishes, Turtle", f"{rosld}topics/cockpit/display", f"{bare}x", seconds, anew=PUT)


if __name__ == "__main__":
    main()
