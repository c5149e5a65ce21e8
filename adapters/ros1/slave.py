"""Slave API: an XML-RPC server through which ROS connects to our publications. Runs only while we publish."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Sequence
from typing import Protocol

from rosld.adapters.model import Refused
from rosld.adapters.model.parameter import ParameterValue
from rosld.adapters.ros1.xmlrpc import (
    Answer,
    Malformed,
    content_length,
    decode_call,
    encode_answer,
    encode_fault,
    read_head,
)

_MAX_REQUEST = 1024 * 1024
_MAX_CONNECTIONS = 200
_IDLE = 15.0


class PublishedTopics(Protocol):
    """Our publications, for the Slave API."""

    @property
    def port(self) -> int:
        """Port of the TCPROS server."""

    def topics(self) -> Sequence[tuple[str, str]]:
        """Return the published topics, with the ROS names of their types."""


class SlaveApi:
    """Responds to calls from the master and from other nodes."""

    def __init__(
        self, master_uri: str, host: str, published: PublishedTopics, shut_down: Callable[[str], None]
    ) -> None:
        self._master_uri = master_uri
        self._host = host
        self._published = published
        self._shut_down = shut_down

    def answer(self, method: str, arguments: Sequence[ParameterValue]) -> Answer:
        """Return the response to a call; code -1 for unknown methods."""
        match method, arguments:
            case "getPid", _:
                return Answer(1, "", os.getpid())
            case "getMasterUri", _:
                return Answer(1, "", self._master_uri)
            case "getPublications", _:
                return Answer(1, "", [[topic, name] for topic, name in self._published.topics()])
            case "getSubscriptions" | "getBusInfo", _:
                return Answer(1, "", [])
            case "getBusStats", _:
                return Answer(1, "", [[], [], []])
            case "publisherUpdate" | "paramUpdate", _:
                return Answer(1, "", 0)
            case "shutdown", _:
                self._shut_down(str(arguments[1]) if len(arguments) > 1 else "")
                return Answer(1, "", 0)
            case "requestTopic", [_, str(topic), list(protocols)]:
                return self._request_topic(topic, protocols)
            case _:
                return Answer(-1, f"there is no method {method[:80]!r} that takes these arguments", 0)

    def _request_topic(self, topic: str, protocols: list[ParameterValue]) -> Answer:
        if topic not in dict(self._published.topics()):
            return Answer(0, f"{topic[:200]} is not published here", [])
        if not any(isinstance(each, list) and each[:1] == ["TCPROS"] for each in protocols):
            return Answer(0, "only TCPROS is spoken here", [])
        return Answer(1, "ready", ["TCPROS", self._host, self._published.port])


class XmlRpcServer:
    """A minimal HTTP/1.1 server for ROS's XML-RPC."""

    def __init__(self, answer: Callable[[str, Sequence[ParameterValue]], Answer]) -> None:
        self._answer = answer
        self._server: asyncio.Server | None = None
        self._open = 0

    async def start(self, bind: str) -> int:
        """Listen on a free port at `bind`; return the port."""
        self._server = await asyncio.start_server(self._serve, bind, 0)
        return int(self._server.sockets[0].getsockname()[1])

    def close(self) -> None:
        """Stop listening."""
        if self._server is not None:
            self._server.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._open += 1
        try:
            while self._open <= _MAX_CONNECTIONS and await asyncio.wait_for(self._turn(reader, writer), _IDLE):
                pass
        except (OSError, EOFError, Malformed, asyncio.TimeoutError):
            pass  # the peer disconnected, or does not speak HTTP
        finally:
            self._open -= 1
            writer.close()

    async def _turn(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bool:
        """Respond to one request; return whether another may follow."""
        line, fields = await read_head(reader)
        length = content_length(fields, _MAX_REQUEST)
        if not line.startswith("POST ") or length is None:
            writer.write(
                b"HTTP/1.1 405 Method Not Allowed\r\nAllow: POST\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
            )
            await writer.drain()
            return False
        body = self._document(await reader.readexactly(length))
        writer.write(b"HTTP/1.1 200 OK\r\nContent-Type: text/xml\r\nContent-Length: %d\r\n\r\n" % len(body) + body)
        await writer.drain()
        return "HTTP/1.1" in line and fields.get("connection", "").lower() != "close"

    def _document(self, request: bytes) -> bytes:
        try:
            method, arguments = decode_call(request)
            return encode_answer(self._answer(method, arguments))
        except (Malformed, Refused) as error:
            return encode_fault(str(error))
