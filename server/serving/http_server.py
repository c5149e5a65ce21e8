"""The HTTP server on its listening socket, and its TLS (`--tls-cert`, `--tls-key`)."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import socket
import ssl
import sys
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import uvicorn
import uvloop
from starlette.types import ASGIApp

from rosld.server.http.token_redaction import redact_tokens, redact_tokens_in
from rosld.server.runtime.tracing import current_request_id
from rosld.server.runtime.version_cache import file_version
from rosld.server.serving.connection import BoundedConfig, Connection, ConnectionBounds
from rosld.server.serving.connections import Connections, WebSocketConnection
from rosld.server.sparql.process.pool import Aborted


def require_certificate(certificate: Path, key: Path | None) -> None:
    """Raise ValueError with a sentence if a certificate cannot be used."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        context.load_cert_chain(certificate, key, password=_no_password)
    except ssl.SSLError as error:
        where = f"--tls-cert {certificate}" + ("" if key is None else f", --tls-key {key}")
        words = (error.reason or str(error)).replace("_", " ").lower()
        raise ValueError(f"{where}: {words}: need a certificate and its private key, both in PEM") from error


def configure_tls(config: uvicorn.Config, certificate: Path | None, key: Path | None) -> None:
    """Configure TLS, if there is a certificate."""
    if certificate is not None:
        config.ssl_certfile = str(certificate)
        config.ssl_keyfile = None if key is None else str(key)


@contextlib.asynccontextmanager
async def reloaded_certificate(
    config: uvicorn.Config, certificate: Path | None, key: Path | None
) -> AsyncIterator[None]:
    """Use a renewed certificate for new connections; one that cannot be used changes nothing."""

    async def watch(path: Path) -> None:
        paths = [path] if key is None else [path, key]
        loaded = [*map(file_version, paths)]
        while True:
            await asyncio.sleep(CERTIFICATE_SECONDS)
            if (versions := [*map(file_version, paths)]) == loaded:
                continue
            loaded = versions
            try:
                require_certificate(path, key)
                assert config.ssl is not None
                config.ssl.load_cert_chain(path, key, password=_no_password)
                _log.info("certificate reloaded from %s", path)
            except (OSError, ValueError) as error:
                _log.error("%s. The former certificate stays in use.", error)

    watching = None if certificate is None else asyncio.get_running_loop().create_task(watch(certificate))
    try:
        yield
    finally:
        if watching is not None:
            watching.cancel()


def _no_password() -> str:
    raise ValueError("the private key is encrypted: provide it without a password, in a file that nobody else can read")


_log = logging.getLogger("rosld")

KEEP_ALIVE_SECONDS = 30
CERTIFICATE_SECONDS = 1.0
"""Seconds between looks at the files of the certificate."""
GRACE_SECONDS = 2
MAX_CONNECTIONS = 3000
"""Maximum number of connections; a new one replaces an idle one, or is limited to POST /stop."""

MESSAGE_BYTES = 1024 * 1024
"""Maximum number of bytes of a WebSocket client's message, such as one that it publishes at `/foxglove`."""


def bind(host: str, port: int) -> socket.socket:
    """Return a bound socket that does not listen yet. Raises ValueError with the reason and the next step."""
    try:
        family, kind, proto, _, address = socket.getaddrinfo(
            host.strip("[]"), port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        sock = socket.socket(family, kind, proto)
    except (OSError, UnicodeError) as error:
        raise ValueError(_bind_error(host, port, error)) from error
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind(address)
        sock.setblocking(False)
    except (OSError, OverflowError) as error:
        sock.close()
        raise ValueError(_bind_error(host, port, error)) from error
    return sock


def _bind_error(host: str, port: int, error: Exception) -> str:
    words = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return f"cannot listen on {host}:{port}: {words}. Choose another with --host and --port."


class Server(uvicorn.Server):
    """Server of uvicorn that reports when it listens, and leaves signals to us (it would end the process too early)."""

    def __init__(
        self,
        app: ASGIApp,
        listening: Callable[[], None],
        bounds: ConnectionBounds | None = None,
        connections: int = MAX_CONNECTIONS,
    ) -> None:
        config = BoundedConfig(
            app,
            http=Connection,
            ws=WebSocketConnection,
            ws_max_size=MESSAGE_BYTES,
            ws_per_message_deflate=False,
            lifespan="off",
            interface="asgi3",
            log_config=None,
            access_log=False,
            proxy_headers=False,
            server_header=False,
            timeout_keep_alive=KEEP_ALIVE_SECONDS,
            timeout_graceful_shutdown=GRACE_SECONDS,
        )
        self._connections = config.connections = Connections(connections)
        if bounds is not None:
            config.bounds = bounds
        super().__init__(config)
        self._listening = listening

    def count_connections(self) -> int:
        """Return the number of open connections."""
        return len(self._connections)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start to listen, then report it."""
        await super().startup(sockets)
        self._listening()

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Capture no signals."""
        yield


def run(main: Coroutine[Any, Any, None]) -> None:
    """Run on a uvloop event loop."""
    uvloop.run(main)


class _WithoutTokens(logging.Formatter):
    """Formatter of records, including tracebacks, that removes tokens of rosld."""

    def format(self, record: logging.LogRecord) -> str:
        return redact_tokens(super().format(record))


class _JsonLines(logging.Formatter):
    """Formatter of records as JSON objects, one a line, without tokens of rosld."""

    def format(self, record: logging.LogRecord) -> str:
        time = datetime.fromtimestamp(record.created, timezone.utc).isoformat(timespec="milliseconds")
        members = {"time": time, "level": record.levelname, "logger": record.name, "message": record.getMessage()}
        if (id := current_request_id.get()) is not None:
            members["request_id"] = id
        members |= getattr(record, "members", {})
        if record.exc_info:
            members["exception"] = self.formatException(record.exc_info)
        return json.dumps({name: redact_tokens_in(value) for name, value in members.items()}, default=str)


def configure_logging(log_format: str = "text") -> None:
    """Log to stderr, as `text` or `json`; from uvicorn only internal errors, not those in received data."""
    handler = logging.StreamHandler(sys.stderr)
    text = _WithoutTokens("%(levelname)s %(name)s: %(message)s")
    handler.setFormatter(_JsonLines() if log_format == "json" else text)
    logging.basicConfig(level=logging.INFO, handlers=[handler])
    uvicorns = logging.getLogger("uvicorn.error")
    uvicorns.setLevel(logging.ERROR)
    uvicorns.addFilter(_unless_cancelled)


def _unless_cancelled(record: logging.LogRecord) -> bool:
    """Drop records of requests that are cancelled when the server ends.

    A deliberately aborted response is logged in one line instead.
    """
    if record.exc_info is not None and isinstance(record.exc_info[1], Aborted):
        _log.info("a response was aborted: %s", record.exc_info[1])
        return False
    cancelled = record.exc_info is not None and record.exc_info[0] is asyncio.CancelledError
    return not cancelled and not record.msg.startswith("Cancel %s running task")
