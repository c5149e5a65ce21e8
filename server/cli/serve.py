"""`rosld serve`: open the source, listen, print the URL, and shut down cleanly on a signal."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import os
import resource
import socket
import threading
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import click

from rosld.adapters.base import Adapter
from rosld.adapters.registry import adapter_for, named_sources
from rosld.server import settings as settings_module
from rosld.server.cli import data_folder
from rosld.server.cli.failure import end_signals, user_errors
from rosld.server.serving.connection import ConnectionBounds
from rosld.server.serving.http_server import (
    Server,
    bind,
    configure_logging,
    configure_tls,
    reloaded_certificate,
    require_certificate,
    run,
)
from rosld.server.serving.lifespan import lifespan
from rosld.server.settings import Settings

if TYPE_CHECKING:
    from rosld.server.app import Application
    from rosld.server.robots.robots import Robots

MAX_FILES = 256
"""Number of open files reserved for other uses than clients: databases, recordings, robots, reserve connections."""
EXIT_SECONDS = 8.0
"""Seconds after which an ending server is killed, whatever still blocks it: Docker kills after ten."""


def serve(source: str, settings: Settings, *, base_given: bool) -> None:
    """Serve a source until a signal. Raises Failure if it cannot start."""
    configure_logging(settings.log_format)
    raise_file_limit()
    with opened(source, settings, _announce, base_given=base_given) as serving:
        run(serving.until_stopped())


@contextlib.contextmanager
def opened(
    source: str, settings: Settings, on_listening: Callable[[str], None], *, base_given: bool
) -> Iterator[Serving]:
    """Yield a server with its bound address and its data folder. Raises Failure if it cannot start."""
    with user_errors():
        sources = named_sources(source.split("\n"))
        adapter = None if sources is not None else adapter_for(source, settings.adapter_options)
        sock = bind(settings.host, settings.port)
    with contextlib.closing(sock), user_errors(), contextlib.ExitStack() as lasting:
        settings = settings_module.bound(settings, sock.getsockname()[1], base_given=base_given)
        if settings.data is not None:
            lasting.enter_context(data_folder.lock(settings.data))
            data_folder.bind_base(settings.data, settings.base_url)
        if settings.tls_cert is not None:
            require_certificate(settings.tls_cert, settings.tls_key)
        _warn(settings)
        from rosld.server.app import create_app

        app: Application | Robots
        if adapter is not None:
            app = create_app(adapter, settings)
        else:
            from rosld.server.robots.robots import Robots

            app = Robots(sources or {}, settings)
            adapter = app.adapter
        yield Serving(app, adapter, sock, lambda: on_listening(settings.base_url))


def _announce(url: str) -> None:
    """Freeze loaded objects, and print the URL; the server continues if stdout is closed."""
    gc.collect()
    gc.freeze()  # a collection that scans the loaded objects would delay all requests
    with contextlib.suppress(OSError):
        print(url, flush=True)


class Serving:
    """The lifecycle of one server: open the source, listen, serve, shut down."""

    def __init__(
        self, app: Application | Robots, adapter: Adapter, sock: socket.socket, on_listening: Callable[[], None]
    ) -> None:
        self._app = app
        self._adapter = adapter
        self._sock = sock
        settings = app.session.settings
        bounds = ConnectionBounds(
            head_seconds=settings.head_timeout,
            connect=app.clients.connect,
            open_websocket=app.clients.open_websocket,
            is_urgent=app.is_urgent,
        )
        limit = min(settings.connections, max_open_files() - MAX_FILES)
        self._server = Server(app, on_listening, bounds, max(limit, 1))
        app.metric_sources.connections = self._server.count_connections
        configure_tls(self._server.config, app.session.settings.tls_cert, app.session.settings.tls_key)
        self._work: asyncio.Task[None] | None = None

    async def until_stopped(self) -> None:
        """Serve until a signal, as `until_ended` does."""
        loop = asyncio.get_running_loop()
        for number in end_signals():
            loop.add_signal_handler(number, self._stop_in_time)
        await self.until_ended()

    async def until_ended(self) -> None:
        """Serve until `stop` is called; the adapter is closed in any case. Raises what opening the source raises."""
        self._work = asyncio.get_running_loop().create_task(self._open_and_serve())
        try:
            with contextlib.suppress(asyncio.CancelledError):
                await self._work
        finally:
            await self._adapter.close()

    async def _open_and_serve(self) -> None:
        settings = self._app.session.settings
        renewed = reloaded_certificate(self._server.config, settings.tls_cert, settings.tls_key)
        async with lifespan(self._app), renewed:
            await self._server.serve(sockets=[self._sock])

    def _stop_in_time(self) -> None:
        end_at_the_latest(EXIT_SECONDS)
        self.stop()

    def stop(self) -> None:
        """Shut down: gracefully on the first call, at once on the second."""
        if not self._server.started and self._work is not None:
            self._work.cancel()
        self._app.end_streams()
        self._server.force_exit = self._server.should_exit
        self._server.should_exit = True


def end_at_the_latest(seconds: float) -> None:
    """End the process after some seconds, even if a thread is stuck."""

    def end() -> None:
        with contextlib.suppress(OSError):  # the terminal may be closed
            os.write(2, b"rosld: ended by force, something did not let go in time\n")
        os._exit(1)

    timer = threading.Timer(seconds, end)
    timer.daemon = True
    timer.start()


def raise_file_limit() -> None:
    """Raise the limit of open files to the maximum: each subscription and each client needs one."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    limit = 65536 if hard == resource.RLIM_INFINITY else min(hard, 65536)
    if soft != resource.RLIM_INFINITY and soft < limit:
        with contextlib.suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (limit, hard))


def max_open_files() -> int:
    """Return the maximum number of open files of this process, including sockets."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return 65536 if soft == resource.RLIM_INFINITY else soft


def _warn(settings: Settings) -> None:
    if settings.open_beyond_loopback:
        sentence = "is reachable from other machines, so this server is read-only: use --auth to define who may write"
        click.echo(f"rosld: {settings.host} {sentence}", err=True)
    elif settings.beyond_loopback and settings.tls_cert is None:
        sentence = "is reachable from other machines, and tokens are sent unencrypted: use --tls-cert, or put a proxy"
        click.echo(f"rosld: {settings.host} {sentence} with TLS before it", err=True)
