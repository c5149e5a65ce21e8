"""The app on the test's own loop, and readers of its streams without sockets."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from typing import Any
from urllib.parse import unquote

import pytest

from rosld.adapters.base import AdapterOptions
from rosld.adapters.registry import adapter_for
from rosld.server.app import Application, create_app
from rosld.server.serving.lifespan import lifespan
from rosld.server.settings import Settings

HOST = b"127.0.0.1:8080"


class Reader:
    """One request: its status, its headers, the part of its body sent so far, and a reader that can pause."""

    def __init__(
        self, app: Application, path: str, headers: dict[str, str], method: str = "GET", body: bytes = b""
    ) -> None:
        plain, _, query = path.partition("?")
        self._scope = {
            "type": "http", "method": method, "path": unquote(plain), "raw_path": plain.encode(),
            "query_string": query.encode(),
            "headers": [(b"host", HOST), *((name.encode(), value.encode()) for name, value in headers.items())],
            "scheme": "http", "http_version": "1.1", "server": ("127.0.0.1", 8080), "client": ("127.0.0.1", 1),
            "root_path": "", "asgi": {"version": "3.0"},
        }  # fmt: skip
        self.status = 0
        self.headers: dict[str, str] = {}
        self.chunks: list[bytes] = []
        self.takes = asyncio.Event()
        self.takes.set()
        self._came = asyncio.Condition()
        self.left = asyncio.Event()
        self._bodies = [body]
        self.task = asyncio.get_running_loop().create_task(app(self._scope, self._receive, self._send))

    async def _receive(self) -> dict[str, Any]:
        if self._bodies:
            return {"type": "http.request", "body": self._bodies.pop(), "more_body": False}
        await self.left.wait()
        return {"type": "http.disconnect"}

    async def _send(self, message: Any) -> None:
        await self.takes.wait()
        async with self._came:
            if message["type"] == "http.response.start":
                self.status = message["status"]
                for name, value in message["headers"]:
                    self.headers.setdefault(name.decode(), "")
                    self.headers[name.decode()] += ", " * bool(self.headers[name.decode()]) + value.decode("latin-1")
            elif message.get("body"):
                self.chunks.append(message["body"])
            self._came.notify_all()

    @property
    def events(self) -> list[bytes]:
        """Return the received events, without comments and the opening."""
        return [chunk for chunk in self.chunks if b"data:" in chunk]

    async def until(self, true: Callable[[Reader], bool], seconds: float = 10.0) -> None:
        """Wait until a condition on the received data holds."""

        async def come() -> None:
            async with self._came:
                await self._came.wait_for(lambda: true(self))

        await asyncio.wait_for(come(), seconds)

    async def leave(self) -> None:
        """Disconnect."""
        self.left.set()
        await asyncio.wait_for(self.task, 60)


@contextlib.asynccontextmanager
async def aircraft_app(**settings: Any) -> AsyncIterator[Application]:
    """Start the aircraft's app, and stop it at the end."""
    chosen = Settings(**{"max_publish_rate": 1e9, "client_streams": 1000, **settings})
    app = create_app(adapter_for("aircraft", AdapterOptions()), chosen)
    async with lifespan(app):
        yield app


@pytest.fixture
def opened() -> Callable[..., Any]:
    """`async with opened(setting=...) as app`."""
    return aircraft_app


@pytest.fixture
def reader() -> Callable[..., Reader]:
    """Start a request: `reader(app, path, accept=...)`."""

    def begin(app: Application, path: str, accept: str = "text/event-stream", **headers: str) -> Reader:
        sent = {"accept": accept, **{name.replace("_", "-"): value for name, value in headers.items()}}
        return Reader(app, path, sent)

    return begin
