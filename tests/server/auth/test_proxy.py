"""rosld behind nginx, with the configuration of `docs/how-to/nginx.conf` except for its ports and files."""

from __future__ import annotations

import asyncio
import json
import shutil
import socket
import ssl
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest
from websockets.asyncio.client import connect

from tests.server.auth.conftest import RULES, TURTLE, token, tokens
from tests.server.auth.test_files import certificate
from tests.server.conftest import Served

pytestmark = pytest.mark.slow

NGINX = shutil.which("nginx") or shutil.which("nginx", path="/usr/sbin")
CONF = Path(__file__).parents[3] / "docs" / "how-to" / "nginx.conf"


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as sock:
        port: int = sock.getsockname()[1]
        return port


@contextmanager
def nginx(folder: Path, port: int, inner: int | str) -> Iterator[ssl.SSLContext]:
    """Run nginx on a port in front of the port `inner`; yield a context that trusts its certificate."""
    if NGINX is None:
        pytest.skip("there is no nginx: apt-get install nginx-light")
    cert, key = certificate(folder)
    conf = (
        CONF.read_text()
        .replace("listen 443 ssl", f"listen 127.0.0.1:{port} ssl")
        .replace("/etc/ssl/robot.example.pem", str(cert))
        .replace("/etc/ssl/robot.example.key", str(key))
        .replace("127.0.0.1:8080", f"127.0.0.1:{inner}")
        .replace("server_name robot.example", "server_name localhost")
    )
    paths = "".join(
        f"{name}_temp_path {folder}/{name};\n" for name in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    )
    whole = folder / "nginx.conf"
    whole.write_text(
        f"daemon off;\nmaster_process off;\npid {folder}/pid;\nerror_log {folder}/error.log;\nevents {{}}\n"
        f"http {{\naccess_log off;\n{paths}{conf}\n}}\n"
    )
    process = subprocess.Popen([NGINX, "-c", str(whole), "-p", str(folder), "-e", f"{folder}/error.log"])
    try:
        deadline = time.monotonic() + 30
        while time.monotonic() < deadline:
            with socket.socket() as sock:
                if sock.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.05)
        yield ssl.create_default_context(cafile=str(cert))
    finally:
        process.terminate()
        process.wait(60)


@pytest.fixture(scope="module")
def proxied(
    start_server: Callable[..., Served], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[str, ssl.SSLContext]]:
    """The URL of the aircraft behind nginx, and a context that trusts its certificate."""
    folder = tmp_path_factory.mktemp("nginx")
    port = free_port()
    base = f"https://localhost:{port}/"
    rules = folder / "auth.toml"
    rules.write_text(tokens("reader", "admin") + RULES)
    served = start_server("aircraft", "--auth", str(rules), "--base-url", base, process=True)
    inner = next(line.rpartition(":")[2].strip().partition(" ")[0] for line in listening(served.process.pid) if line)
    with nginx(folder, port, inner) as trusted:
        yield base, trusted


def listening(pid: int) -> list[str]:
    """Return the addresses on which a process listens: `127.0.0.1:PORT`."""
    inodes = {
        link.readlink().name for link in Path(f"/proc/{pid}/fd").iterdir() if link.readlink().name.startswith("socket:")
    }
    found = []
    for row in Path("/proc/net/tcp").read_text().splitlines()[1:]:
        parts = row.split()
        if parts[3] == "0A" and f"socket:[{parts[9]}]" in inodes:
            found.append(f"127.0.0.1:{int(parts[1].partition(':')[2], 16)}")
    return found


def test_what_is_behind_the_proxy_is_as_it_is_without(proxied: tuple[str, ssl.SSLContext]) -> None:
    base, trusted = proxied
    with httpx.Client(base_url=base, verify=trusted, headers={"Authorization": f"Bearer {token('admin')}"}) as client:
        answer = client.get("/topics/", headers={"Accept": "text/turtle"})
        assert answer.status_code == 200
        assert f"{base}topics/" in answer.text
        assert client.get("/topics/", headers={"Authorization": ""}).status_code == 401
        assert client.put("/data/a%2Fb", content="", headers=TURTLE).headers["location"] == f"{base}data/a%2Fb"
        assert (
            client.put("/data/large", content=b"x" * 3_000_000, headers={"Content-Type": "text/plain"}).status_code
            == 201
        )
        origin = {"Origin": base.rstrip("/")}
        assert client.post("/services/aircraft/stop", headers=origin).status_code in (200, 201)
        assert client.post("/services/aircraft/stop", headers={"Origin": "https://evil.example"}).status_code == 403


def test_streams_and_channels_go_through_as_they_come(proxied: tuple[str, ssl.SSLContext]) -> None:
    base, trusted = proxied
    with httpx.Client(base_url=base, verify=trusted, headers={"Authorization": f"Bearer {token('admin')}"}) as client:
        with client.stream("GET", "/data/", headers={"Accept": "text/event-stream"}) as stream:
            assert next(line for line in stream.iter_lines() if line.startswith("data"))
        wish = {
            "@context": ["https://www.w3.org/ns/solid/notification/v1"],
            "type": "http://www.w3.org/ns/solid/notifications#WebSocketChannel2023",
            "topic": f"{base}data/",
        }
        kind = {"Content-Type": "application/ld+json", "Accept": "application/ld+json"}
        made = client.post("/channels/WebSocketChannel2023", content=json.dumps(wish), headers=kind).json()
        assert made["receiveFrom"].startswith("wss://")

        async def first_message() -> str:
            # One thread: OpenSSL's connections are not for a thread that reads while another writes.
            async with connect(made["receiveFrom"], ssl=trusted, open_timeout=30) as notifications:
                await asyncio.to_thread(client.put, "/data/through", content="", headers=TURTLE)
                return str(await asyncio.wait_for(notifications.recv(), 30))

        assert "through" in asyncio.run(first_message())


def exchange(port: int, trusted: ssl.SSLContext, request: bytes) -> bytes:
    """Return the response to these bytes of the TLS server on a port, until it ends the connection."""
    with (
        socket.create_connection(("127.0.0.1", port), timeout=30) as plain,
        trusted.wrap_socket(plain, server_hostname="localhost") as sock,
    ):
        sock.sendall(request)
        found = b""
        while piece := sock.recv(65536):
            found += piece
        return found


def test_nginx_passes_on_an_upgrade_to_a_websocket_alone(tmp_path: Path) -> None:
    port = free_port()
    with socket.create_server(("127.0.0.1", 0)) as inner, nginx(tmp_path, port, inner.getsockname()[1]) as trusted:
        heads: list[bytes] = []

        def answer() -> None:
            connection, _ = inner.accept()
            with connection:
                heads.append(connection.recv(65536))
                connection.sendall(b"HTTP/1.1 204 No Content\r\nConnection: close\r\n\r\n")

        for asked, passed in (("h2c", None), ("WebSocket", "websocket"), ("h2c, websocket", None), (None, None)):
            thread = threading.Thread(target=answer, daemon=True)
            thread.start()
            upgrade = "" if asked is None else f"Connection: Upgrade\r\nUpgrade: {asked}\r\n"
            exchange(port, trusted, f"GET / HTTP/1.0\r\nHost: localhost\r\n{upgrade}\r\n".encode())
            thread.join(10)
            lines = heads.pop().lower().decode().split("\r\n")
            assert next((line.partition(": ")[2] for line in lines if line.startswith("upgrade:")), None) == passed
            assert ("connection: upgrade" in lines) is (passed is not None)
