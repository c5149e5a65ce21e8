"""Isolation of clients by limits: the latency of one client, alone and in parallel with a greedy one.

Run: python bench/clients.py [seconds]. The clients are addresses of this machine, 127.0.0.2 (greedy, on eight
connections) and 127.0.0.3; the limits of clients are off, then on.
"""

from __future__ import annotations

import asyncio
import statistics
import subprocess
import sys
import time
from urllib.parse import urlsplit

from web import ROUNDS, serving

GREEDY, MODEST = "127.0.0.2", "127.0.0.3"
CONNECTIONS = 8
MODEST_RATE = 50
FLOOD = "--flood"


async def ask(url: str, address: str, seconds: float, rate: float | None) -> list[float]:
    """Request a page repeatedly on one connection, at a limited rate; return the latencies in seconds."""
    parts = urlsplit(url)
    reader, writer = await asyncio.open_connection(parts.hostname, parts.port, local_addr=(address, 0))
    request = f"GET {parts.path} HTTP/1.1\r\nHost: {parts.netloc}\r\nAccept: text/html\r\n\r\n".encode()
    took: list[float] = []
    until = time.monotonic() + seconds
    while (begun := time.monotonic()) < until:
        writer.write(request)
        head = await reader.readuntil(b"\r\n\r\n")
        length = next(line for line in head.lower().split(b"\r\n") if line.startswith(b"content-length"))
        await reader.readexactly(int(length.split(b":")[1]))
        took.append(time.monotonic() - begun)
        if rate is not None:
            await asyncio.sleep(max(0.0, 1 / rate - took[-1]))
    writer.close()
    return took


async def flood(url: str, seconds: float) -> None:
    """Request the page as fast as possible."""
    await asyncio.gather(*(ask(url, GREEDY, seconds, None) for _ in range(CONNECTIONS)))


def measured(url: str, seconds: float) -> float:
    """Return the median latency of the modest client in milliseconds."""
    return statistics.median(asyncio.run(ask(url, MODEST, seconds, MODEST_RATE))) * 1000


def beside(url: str, seconds: float) -> float:
    """Return the same while another process floods the server."""
    greedy = subprocess.Popen([sys.executable, __file__, FLOOD, url, str(seconds + 1)])
    try:
        time.sleep(0.5)  # until it has started
        return measured(url, seconds)
    finally:
        greedy.wait(seconds + 10)


def main() -> None:
    """Print the table."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 3.0
    print(f"{'median answer to the modest client':36}{'alone':>10}{'beside':>10}{'ratio':>8}")
    for label, options in (("without limits", ()), ("with limits (--limit-loopback)", ("--limit-loopback",))):
        with serving("-m", "rosld", "serve", "aircraft", "--port", "0", *options) as base:
            pairs = [(measured(f"{base}topics/", seconds), beside(f"{base}topics/", seconds)) for _ in range(ROUNDS)]
        alone, busy = (statistics.median(pair[at] for pair in pairs) for at in (0, 1))
        print(f"{label:36}{alone:8.1f}ms{busy:8.1f}ms{alone / busy:8.2f}")


if __name__ == "__main__":
    if FLOOD in sys.argv:
        asyncio.run(flood(sys.argv[2], float(sys.argv[3])))
    else:
        main()
