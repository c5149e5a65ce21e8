"""Servers on threads of the tests' process: 40 ms of CPU each, where a separate process takes over a second."""

from __future__ import annotations

import asyncio
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from functools import partial
from typing import Any, TypeAlias

from rosld.adapters.base import Adapter
from rosld.server.cli.main import serve as command
from rosld.server.cli.options import settings_of
from rosld.server.cli.serve import Serving, opened
from rosld.server.serving.http_server import bind, run
from rosld.server.settings import Settings, address

Open: TypeAlias = "Callable[[Callable[[str], None]], AbstractContextManager[Serving]]"
"""Run a server that calls back with its URL once it listens."""


class ServingThread:
    """A server on a thread, with the used part of the interface of `subprocess.Popen`."""

    def __init__(self, open: Open) -> None:
        self._url: Future[str] = Future()
        self._failure: BaseException | None = None
        self._serving: Serving | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread = threading.Thread(target=self._run, args=(open,), daemon=True)
        self._thread.start()

    @classmethod
    def of_command(cls, *arguments: str) -> ServingThread:
        """Run `rosld serve ARGUMENTS`."""
        return cls(partial(_opened_command, arguments))

    @classmethod
    def of_adapter(cls, adapter: Adapter, **settings: Any) -> ServingThread:
        """Serve an adapter on a free port."""
        return cls(partial(_opened_adapter, adapter, settings))

    def url(self) -> str:
        """Wait until the server listens; raise what it raised if it does not."""
        return self._url.result(60)

    def poll(self) -> int | None:
        """Return None while the server runs."""
        return None if self._thread.is_alive() else 0

    def wait(self, timeout: float) -> int:
        """Wait until the server has ended; raise what it raised after it had begun to listen."""
        self._thread.join(timeout)
        assert not self._thread.is_alive(), "the server did not end"
        if self._failure is not None:
            raise self._failure
        return 0

    def send_signal(self, number: signal.Signals) -> None:
        """Stop the server as this signal would."""
        assert number in (signal.SIGTERM, signal.SIGINT)
        if self._thread.is_alive() and self._loop and self._serving:
            with suppress(RuntimeError):  # the loop has just ended
                self._loop.call_soon_threadsafe(self._serving.stop)

    def _run(self, open: Open) -> None:
        try:
            with open(self._url.set_result) as serving:
                run(self._serve(serving))
        except BaseException as error:
            if self._url.done():
                self._failure = error
            else:
                self._url.set_exception(error)

    async def _serve(self, serving: Serving) -> None:
        self._serving, self._loop = serving, asyncio.get_running_loop()
        await serving.until_ended()


def _opened_command(arguments: tuple[str, ...], on_listening: Callable[[str], None]) -> AbstractContextManager[Serving]:
    context = command.make_context("serve", list(arguments))
    given = context.params
    source, base_url = given.pop("source"), given["base_url"]
    with context:
        settings = settings_of(given.pop("others"), given.pop("base_url"), **given)
    return opened(source, settings, on_listening, base_given=base_url is not None)


@contextmanager
def _opened_adapter(adapter: Adapter, given: dict[str, Any], on_listening: Callable[[str], None]) -> Iterator[Serving]:
    from rosld.server.app import create_app

    with closing(bind("127.0.0.1", 0)) as sock:
        port = sock.getsockname()[1]
        settings = Settings(base_url=address("127.0.0.1", port), port=port, **given)
        app = create_app(adapter, settings)
        yield Serving(app, adapter, sock, lambda: on_listening(settings.base_url))
