"""GET and PUT of a stored 1 kB Turtle resource, compared to a bare Starlette and Community Solid Server, in one run.

Run: python bench/ldp.py [seconds]. Needs `wrk` (Debian: apt-get install wrk). Community Solid Server needs Node and
npm: the first run installs it into ~/.cache/rosld; without them its rows are omitted.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

import httpx
from web import ANEW, BASELINE, ROUNDS, Rate, measure, serving

PACKAGE = "@solid/community-server"
VERSION = "7.2.0"
READY_SECONDS = 120
TURTLE = {"Content-Type": "text/turtle"}
BODY = "".join(
    f'<#reading{number}> <http://purl.org/dc/terms/description> "the wind at gate {number}, in knots" .\n'
    for number in range(10)
)
PUT = f"""
local number = 0
local headers = {{ ["Content-Type"] = "text/turtle" }}
request = function()
  number = number + 1
  return wrk.format("PUT", nil, headers, [[{BODY}]] .. "<> <http://purl.org/dc/terms/title> \\"" .. number .. "\\" .")
end
"""
"""No two bodies are the same, so that no work is saved."""
OTHER_CONFIGS = {
    "app/init/initialize-intro": "app/init/initialize-root",
    "http/notifications/all": "http/notifications/disabled",
    "ldp/authorization/webacl": "ldp/authorization/allow-all",
    "storage/key-value/resource-store": "storage/key-value/memory",
    "util/auxiliary/acl": "util/auxiliary/empty",
}
"""Overrides that make Community Solid Server light; its defaults are in memory already."""


class Server(NamedTuple):
    """A server, with the URL of the container for all resources."""

    name: str
    url: str


# Community Solid Server


def installed() -> Path | None:
    """Return the folder of Community Solid Server, installed if necessary; print why it is missing and return None."""
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "rosld" / f"community-server-{VERSION}"
    package = folder / "node_modules" / PACKAGE
    if (folder / "complete").exists():
        return package
    if shutil.which("node") is None or shutil.which("npm") is None:
        print("Community Solid Server is left out: it needs Node and npm")
        return None
    folder.mkdir(parents=True, exist_ok=True)
    command = ["npm", "install", "--no-audit", "--no-fund", "--prefix", str(folder), f"{PACKAGE}@{VERSION}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        print(f"Community Solid Server is left out: npm could not install it: {done.stderr.strip()[-300:]}")
        return None
    (folder / "complete").touch()
    return package


@contextmanager
def community_solid_server(package: Path, folder: Path) -> Iterator[str]:
    """Run Community Solid Server in memory, open to all, on a free port, until it is ready."""
    config = json.loads((package / "config" / "default.json").read_text())
    names = (name.removeprefix("css:config/").removesuffix(".json") for name in config["import"])
    config["import"] = [f"css:config/{OTHER_CONFIGS.get(name, name)}.json" for name in names]
    config["@graph"] = []
    (folder / "config.json").write_text(json.dumps(config))
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    url = f"http://127.0.0.1:{port}/"
    command = [
        "node",
        str(package / "bin" / "server.js"),
        "-c",
        str(folder / "config.json"),
        "-p",
        str(port),
        "-b",
        url,
    ]
    process = subprocess.Popen([*command, "-l", "error"], cwd=folder, stdout=subprocess.DEVNULL)
    try:
        _wait_for(url, process)
        yield url
    finally:
        process.terminate()
        process.wait(10)


def _wait_for(url: str, process: subprocess.Popen[bytes]) -> None:
    until = time.monotonic() + READY_SECONDS
    while time.monotonic() < until and process.poll() is None:
        try:
            if httpx.get(url).is_success:
                return
        except httpx.TransportError:
            pass
        time.sleep(0.2)
    raise SystemExit("Community Solid Server did not start")


# The table


def rates(servers: list[Server], seconds: int, *options: str) -> dict[str, list[Rate]]:
    """Return the rate of each server, measured in turn, in rounds."""
    found: dict[str, list[Rate]] = {server.name: [] for server in servers}
    for _ in range(ROUNDS):
        for server in servers:
            found[server.name].append(measure(f"{server.url}x", seconds, *options))
    return found


def table(label: str, found: dict[str, list[Rate]]) -> None:
    """Print a row per server: requests per second, and the ratio of rosld to it."""
    print(label)
    for name, measured in found.items():
        ratio = statistics.median(
            ours.per_second / one.per_second for ours, one in zip(found["rosld"], measured, strict=True)
        )
        failures = sum(one.failures for one in measured)
        failed = f"  {failures} failed" if failures else ""
        print(f"  {name:32}{statistics.median(one.per_second for one in measured):10.0f}/s{ratio:10.2f}{failed}")


def main() -> None:
    """Print the tables."""
    if shutil.which("wrk") is None:
        raise SystemExit("bench/ldp.py needs wrk: apt-get install wrk")
    seconds = int(sys.argv[1]) if len(sys.argv) > 1 else 4
    package = installed()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        script, anew = folder / "put.lua", folder / "anew.lua"
        script.write_text(PUT)
        anew.write_text(ANEW)
        serve = ("-m", "rosld", "serve", "aircraft", "--port", "0")
        on_disk = ("--data", str(folder / "data"))
        servers = [
            Server("rosld", stack.enter_context(serving(*serve)) + "data/"),
            Server("rosld, on disk (--data)", stack.enter_context(serving(*serve, *on_disk)) + "data/"),
            Server("bare Starlette", stack.enter_context(serving("-c", BASELINE))),
        ]
        if package is not None:
            url = stack.enter_context(community_solid_server(package, folder))
            servers.append(Server("Community Solid Server", url))
        for server in servers:
            httpx.put(f"{server.url}x", content=BODY, headers=TURTLE).raise_for_status()
        print(f"{'':36}{'requests':>8}{'rosld : it':>12}")
        reading = ("-H", "Accept: text/turtle")
        table("GET, 1 kB Turtle, no two requests the same", rates(servers, seconds, *reading, "-s", str(anew)))
        table("PUT, 1 kB Turtle, each other than the last", rates(servers, seconds, "-s", str(script)))


if __name__ == "__main__":
    main()
