"""Client of a SPARQL endpoint: one persistent connection, one request at a time, bounded in time and size.

Neither redirects nor proxies are followed: a request arrives at the named URL or nowhere.
"""

from __future__ import annotations

import contextlib
import json
import socket
import ssl
import threading
from collections.abc import Callable, Iterator
from http.client import HTTPConnection, HTTPException, HTTPResponse, HTTPSConnection
from typing import NamedTuple
from urllib.parse import urlsplit

_CONNECT = 5.0
"""Maximum seconds for connecting, which are part of a request's time."""
_WORDS = 300
"""Maximum number of characters quoted from an endpoint's message."""


class StoreError(Exception):
    """Failure of a store: a sentence with the reason, and apart from it the endpoint's own `words`."""

    def __init__(self, sentence: str, words: str | None = None) -> None:
        super().__init__(f"{sentence} It said: {json.dumps(words, ensure_ascii=False)}." if words else sentence)
        self.sentence = sentence
        self.words = words


class StoreUnreachable(StoreError):
    """No readable response: it is unknown whether the request was carried out."""


class StoreRefused(StoreError):
    """A request that the endpoint refused; `status` is the HTTP status."""

    def __init__(self, sentence: str, status: int, words: str | None = None) -> None:
        super().__init__(sentence, words)
        self.status = status


class Response(NamedTuple):
    """Response of an endpoint: media type without parameters, complete body, and the Content-Type header."""

    media_type: str
    body: bytes
    content_type: str


class Endpoint:
    """Sends requests to one URL. Thread-safe; requests wait for each other.

    `seconds` limits a request from connecting to the last byte; `limit` is the maximum size of a response in bytes.
    `authorization` is the value of that header. TLS certificates are verified with the system's trust store.
    """

    def __init__(
        self, url: str, authorization: str | None = None, *, seconds: float = 30.0, limit: int = 64 * 1024 * 1024
    ) -> None:
        self.url = url
        self.seconds = seconds
        self.connections = 0
        """Number of connections made. While it does not change, the same server has responded."""
        self._limit = limit
        parts = urlsplit(url)
        self._target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
        self._headers = {} if authorization is None else {"Authorization": authorization}
        self._new = _opener(parts.scheme, parts.hostname or "", parts.port)
        self._connection: HTTPConnection | None = None
        self._socket: socket.socket | None = None
        self._turn = threading.Lock()

    def post(self, body: bytes, content_type: str, accept: str) -> Response:
        """Send a body; return a successful (2xx) response. Raises StoreUnreachable, StoreRefused.

        If the persistent connection was closed, the request is sent again on a new one: it must be idempotent.
        """
        return self._send("POST", body, {**self._headers, "Content-Type": content_type, "Accept": accept})

    def get(self, accept: str) -> Response:
        """Return a successful (2xx) response to a GET request. Raises StoreUnreachable, StoreRefused."""
        return self._send("GET", None, {**self._headers, "Accept": accept})

    def close(self) -> None:
        """Close the connection. Idempotent."""
        with self._turn:
            self._drop()

    def _send(self, method: str, body: bytes | None, headers: dict[str, str]) -> Response:
        with self._turn:
            is_reused = self._connection is not None
            try:
                return self._exchange(method, body, headers)
            except (ConnectionError, HTTPException) as error:
                self._drop()
                if not is_reused:
                    raise self._unreachable(error) from error
            except OSError as error:
                raise self._unreachable(error) from error
            try:
                return self._exchange(method, body, headers)
            except (OSError, HTTPException) as error:
                raise self._unreachable(error) from error

    def interrupt(self) -> None:
        """Abort the current request, if any, from another thread."""
        waited = self._socket
        if waited is not None:
            _shut_down(waited)

    def _unreachable(self, error: Exception) -> StoreUnreachable:
        self._drop()
        if isinstance(error, TimeoutError):
            return StoreUnreachable(f"{self.url} did not respond within {self.seconds:g} s.")
        if isinstance(error, HTTPException):  # its message quotes the response
            return StoreUnreachable(f"{self.url} sent an unreadable response.", _words(str(error)))
        return StoreUnreachable(f"{self.url} did not respond: {_words(str(error) or type(error).__name__)}.")

    def _exchange(self, method: str, body: bytes | None, headers: dict[str, str]) -> Response:
        connection = self._connection or self._connect()
        with _time_limit(lambda: self._socket, self.seconds):
            connection.request(method, self._target, body, headers)
            answer = connection.getresponse()
            stated = answer.getheader("Content-Type") or ""
            media_type = stated.partition(";")[0].strip().lower()
            if not 200 <= answer.status < 300:
                raise self._refusal(answer)
            read = answer.read(self._limit + 1)
            if answer.length and len(read) <= self._limit:
                raise HTTPException("the response was cut off")
            if len(read) > self._limit:
                self._drop()
                raise StoreUnreachable(f"{self.url} responds with more than {self._limit} bytes.")
            if answer.will_close or not answer.isclosed():
                self._drop()
        return Response(media_type, read, stated)

    def _connect(self) -> HTTPConnection:
        self.connections += 1
        connection = self._connection = self._new(min(_CONNECT, self.seconds))
        with _time_limit(lambda: connection.sock, self.seconds):
            connection.connect()
        self._socket = connection.sock  # http.client drops it while the response is still being read
        connection.sock.settimeout(self.seconds)
        return connection

    def _refusal(self, answer: HTTPResponse) -> StoreRefused:
        """Return the error for a response. The connection is reused only if the response was read to its end."""
        words = _words(answer.read(16 * _WORDS).decode("utf-8", "replace"))
        if answer.will_close or not answer.isclosed():
            self._drop()
        if 300 <= answer.status < 400:
            words = _words(answer.getheader("Location") or "")
            sentence = f"{self.url} redirects, which is not followed: use the final URL."
        else:
            words = words or _words(answer.reason)
            sentence = f"{self.url} answers {answer.status}."
        return StoreRefused(sentence, answer.status, words)

    def _drop(self) -> None:
        connection, self._connection, self._socket = self._connection, None, None
        if connection is not None:
            connection.close()


def _opener(scheme: str, host: str, port: int | None) -> Callable[[float], HTTPConnection]:
    """Return a function that creates an unopened connection with this timeout per operation."""
    if scheme == "https":
        context = ssl.create_default_context()
        return lambda seconds: HTTPSConnection(host, port, timeout=seconds, context=context)
    return lambda seconds: HTTPConnection(host, port, timeout=seconds)


@contextlib.contextmanager
def _time_limit(waited: Callable[[], socket.socket | None], seconds: float) -> Iterator[None]:
    """Shut down the socket after `seconds`, however slowly bytes arrive, and then raise TimeoutError."""
    late = threading.Event()

    def end() -> None:
        late.set()
        there = waited()
        if there is not None:
            _shut_down(there)

    timer = threading.Timer(seconds, end)
    timer.daemon = True
    timer.start()
    try:
        yield
        if late.is_set():  # the response may have been cut off
            raise TimeoutError
    except (OSError, HTTPException, ValueError) as error:
        if late.is_set():
            raise TimeoutError from error
        if isinstance(error, ValueError):  # raised by http.client for some malformed responses
            raise HTTPException(str(error)) from error
        raise
    finally:
        timer.cancel()


def _shut_down(waited: socket.socket) -> None:
    """Wake the thread that waits for the socket."""
    with contextlib.suppress(OSError, ValueError):
        socket.socket.shutdown(waited, socket.SHUT_RDWR)  # bypass TLS, which would wait for the peer


def _words(text: str) -> str:
    """Return foreign text in a form that is safe for one line of a log."""
    return "".join(char if char.isprintable() else " " for char in " ".join(text.split()))[:_WORDS].strip()
