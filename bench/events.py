"""Fan-out: one topic at 100 Hz to 200 event-stream readers, compared to a bare Starlette stream on the same server.

Run: python bench/events.py [seconds [readers]]. Each message has the time at which it was sent; the lag is the time
from then until the reader receives it. The ratio is that of events per CPU second of the server, which excludes the
readers.
"""

from __future__ import annotations

import asyncio
import os
import re
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple, cast
from urllib.parse import urlsplit

RATE = 100
ROUNDS = 3
BASELINE = """
import asyncio, socket, uvicorn
from starlette.applications import Starlette
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route

latest, changed = b"", asyncio.Event()

async def write(request):
    global latest, changed
    latest = b"data: " + await request.body() + b"\\n\\n"
    changed.set()
    changed = asyncio.Event()
    return Response(status_code=204)

async def tell():
    while True:
        await changed.wait()
        yield latest

async def read(request):
    return StreamingResponse(tell(), media_type="text/event-stream")

app = Starlette(routes=[Route("/x", read, methods=["GET"]), Route("/x", write, methods=["PUT"])])
sock = socket.socket(); sock.bind(("127.0.0.1", 0))
print(f"http://127.0.0.1:{sock.getsockname()[1]}/", flush=True)
config = uvicorn.Config(app, loop="uvloop", http="httptools", access_log=False, log_level="error")
uvicorn.Server(config).run(sockets=[sock])
"""
_STAMP = re.compile(rb'"at ([0-9]+)"')


class Fanout(NamedTuple):
    """Results of the readers: events per second each, events per CPU second of the server, lags in milliseconds."""

    each: float
    per_cpu_second: float
    median: float
    longest: float


class Reader(asyncio.Protocol):
    """One event-stream reader that records the lag of each message."""

    def __init__(self, path: str, host: str, lags: list[float]) -> None:
        self._head = f"GET {path} HTTP/1.1\r\nHost: {host}\r\nAccept: text/event-stream\r\n\r\n".encode()
        self._lags = lags
        self._rest = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        cast(asyncio.Transport, transport).write(self._head)

    def data_received(self, data: bytes) -> None:
        text = self._rest + data
        end = text.rfind(b"\n") + 1
        self._rest = text[end:]
        now = time.monotonic_ns()
        self._lags.extend((now - int(stamp)) / 1e6 for stamp in _STAMP.findall(text[:end]))


@contextmanager
def serving(*command: str) -> Iterator[tuple[str, int]]:
    """Run a server as a process; yield the URL that it prints first, and its id."""
    process = subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield process.stdout.readline().strip(), process.pid
    finally:
        process.terminate()
        process.wait(10)


def spent(process: int) -> float:
    """Return the CPU seconds that a process has used."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


async def fan_out(url: str, process: int, path: str, query: str, readers: int, seconds: float) -> Fanout:
    """Publish at 100 Hz for some seconds to this number of readers."""
    parts = urlsplit(url)
    loop = asyncio.get_running_loop()
    lags: list[float] = []
    made = [
        await loop.create_connection(lambda: Reader(path + query, parts.netloc, lags), parts.hostname, parts.port)
        for _ in range(readers)
    ]
    incoming, outgoing = await asyncio.open_connection(parts.hostname, parts.port)

    async def publish(count: int) -> None:
        began = loop.time()
        for turn in range(count):
            await asyncio.sleep(began + turn / RATE - loop.time())
            body = b'{"data":"at %d"}' % time.monotonic_ns()
            head = f"PUT {path} HTTP/1.1\r\nHost: {parts.netloc}\r\nContent-Type: application/json\r\n"
            outgoing.write(f"{head}Content-Length: {len(body)}\r\n\r\n".encode() + body)
            assert b" 204" in (await incoming.readuntil(b"\r\n\r\n"))[:14]

    await publish(RATE)  # until all are connected
    lags.clear()
    before, began = spent(process), time.monotonic()
    await publish(int(RATE * seconds))
    took, used = time.monotonic() - began, spent(process) - before
    await asyncio.sleep(0.5)
    for transport, _ in made:
        transport.close()
    outgoing.close()
    return Fanout(len(lags) / readers / took, len(lags) / used, statistics.median(lags), max(lags))


def main() -> None:
    """Print the table."""
    import uvloop

    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 5.0
    readers = int(sys.argv[2]) if len(sys.argv) > 2 else 200
    serve = ("-m", "rosld", "serve", "aircraft", "--port", "0", "--max-publish-rate", "1000000000")
    with serving("-c", BASELINE) as bare, serving(*serve) as rosld:
        rows: dict[str, list[Fanout]] = {"rosld": [], "bare": []}
        for _ in range(ROUNDS):
            at = fan_out(*rosld, "/topics/cockpit/display", f"?rate={RATE}", readers, seconds)
            rows["rosld"].append(uvloop.run(at))
            rows["bare"].append(uvloop.run(fan_out(*bare, "/x", "", readers, seconds)))
    print(f"{RATE} Hz to {readers} readers")
    print(f"{'':10}{'Hz each':>10}{'events/CPU s':>14}{'median lag ms':>15}{'longest ms':>12}")
    for name, rounds in rows.items():
        each, per, median, _ = (statistics.median(column) for column in zip(*rounds, strict=True))
        print(f"{name:10}{each:10.1f}{per:14.0f}{median:15.1f}{max(one.longest for one in rounds):12.1f}")
    pairs = zip(rows["rosld"], rows["bare"], strict=True)
    print(f"ratio {statistics.median(ours.per_cpu_second / theirs.per_cpu_second for ours, theirs in pairs):.2f}")


if __name__ == "__main__":
    main()
