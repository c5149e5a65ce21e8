"""CPU of a tool for language models (`look`) beside an empty tool of the same SDK and a plain GET, in one run.

Run: python bench/tools.py [calls]
"""

from __future__ import annotations

import http.client
import json
import os
import statistics
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from urllib.parse import urlsplit

ROUNDS = 5
EMPTY = """
import contextlib, socket, uvicorn
from mcp import types
from mcp.server.lowlevel.server import Server
from mcp.server.streamable_http_manager import StreamableHTTPSessionManager
from starlette.applications import Starlette
from starlette.routing import Mount

async def listed(context, params):
    return types.ListToolsResult(tools=[types.Tool(name="look", input_schema={"type": "object"})])

async def call(context, params):
    return types.CallToolResult(content=[types.TextContent(type="text", text="1")], structured_content={"data": 1})

manager = StreamableHTTPSessionManager(Server("empty", on_list_tools=listed, on_call_tool=call))

@contextlib.asynccontextmanager
async def lifespan(app):
    async with manager.run():
        yield

app = Starlette(routes=[Mount("/", app=manager.handle_request)], lifespan=lifespan)
sock = socket.socket(); sock.bind(("127.0.0.1", 0))
print(f"http://127.0.0.1:{sock.getsockname()[1]}/", flush=True)
config = uvicorn.Config(app, loop="uvloop", http="httptools", access_log=False, log_level="error")
uvicorn.Server(config).run(sockets=[sock])
"""
PATH = "topics/cockpit/display"
VERSION = "2026-07-28"
META = {
    "io.modelcontextprotocol/protocolVersion": VERSION,
    "io.modelcontextprotocol/clientCapabilities": {},
    "io.modelcontextprotocol/clientInfo": {"name": "bench", "version": "1"},
}
CALL = {"name": "look", "arguments": {"url": f"/{PATH}"}, "_meta": META}
BODY = json.dumps({"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": CALL}).encode()
FIELDS = {
    "Content-Type": "application/json",
    "Accept": "application/json, text/event-stream",
    "MCP-Protocol-Version": VERSION,
    "Mcp-Method": "tools/call",
    "Mcp-Name": "look",
}


@contextmanager
def serving(*command: str) -> Iterator[tuple[int, str]]:
    """Run a server as a process; yield its id and URL, the first line that it prints."""
    process = subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield process.pid, process.stdout.readline().strip()
    finally:
        process.terminate()
        process.wait(10)


def cpu(pid: int) -> float:
    """Return the CPU seconds of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory(pid: int) -> int:
    """Return the resident memory of a process in MB."""
    (line,) = (one for one in Path(f"/proc/{pid}/status").read_text().splitlines() if one.startswith("VmRSS"))
    return int(line.split()[1]) // 1024


def sender(url: str, method: str, path: str, body: bytes, fields: Mapping[str, str]) -> Callable[[], None]:
    """Return a function that sends a request on one connection."""
    connection = http.client.HTTPConnection(urlsplit(url).netloc)

    def send() -> None:
        connection.request(method, f"/{path}", body, dict(fields))
        answer = connection.getresponse()
        text = answer.read()
        assert answer.status == 200, text
        assert b'isError":true' not in text, text

    return send


def measure(pid: int, connect: Callable[[], Callable[[], None]], calls: int) -> float:
    """Return the CPU microseconds of a request."""
    send = connect()
    begin = cpu(pid)
    for _ in range(calls):
        send()
    return (cpu(pid) - begin) / calls * 1e6


def main() -> None:
    """Print the table."""
    calls = int(sys.argv[1]) if len(sys.argv) > 1 else 2000
    with (
        serving("-c", EMPTY) as (empty, bare),
        serving("-m", "rosld", "serve", "aircraft", "--port", "0") as (pid, url),
    ):
        display = http.client.HTTPConnection(urlsplit(url).netloc)
        display.request("PUT", f"/{PATH}", b'{"data": "climb"}', {"Content-Type": "application/json"})
        display.getresponse().read()
        before = memory(pid)
        requests = {
            "GET": (pid, partial(sender, url, "GET", PATH, b"", {"Accept": "application/json"})),
            "empty tool": (empty, partial(sender, bare, "POST", "mcp", BODY, FIELDS)),
            "look": (pid, partial(sender, url, "POST", "mcp", BODY, FIELDS)),
        }
        for _, connect in requests.values():
            connect()()
        print(f"memory: {before} MB, with the first call of a tool {memory(pid)} MB")
        rounds = [{name: measure(*each, calls) for name, each in requests.items()} for _ in range(ROUNDS)]
        for name in requests:
            print(f"{name:12}{statistics.median(each[name] for each in rounds):8.0f} us")
        excess = statistics.median((each["look"] - each["empty tool"]) / each["GET"] for each in rounds)
        print(f"look = empty tool + {excess:.2f} GETs")


if __name__ == "__main__":
    main()
