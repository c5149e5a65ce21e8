"""Client of a rosbridge server: requests over its connection, and the types of the robot behind it."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
import time
from collections.abc import Callable, Mapping
from typing import Any

from rosld.adapters.base import AdapterOptions
from rosld.adapters.bridge_connection import BridgeConnection, BridgeSource, Calls, Session
from rosld.adapters.model import (
    Encoding,
    Message,
    MessageSchema,
    Refused,
    RosError,
    Schema,
    Sent,
    TimedOut,
    TypeRef,
    UnknownType,
    Unreachable,
)
from rosld.adapters.model.definition import enclosing_type, written_form
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.model.plain import LibraryMessages, message_of, plain_of
from rosld.adapters.rosbridge.protocol import definition_of, encode_message, ros1_name

_ANSWER_SECONDS = 5.0
_DETAILS = {
    "msg": ("message_details",),
    "srv": ("service_request_details", "service_response_details"),
    "action": ("action_goal_details", "action_result_details", "action_feedback_details"),
}
"""rosapi's services that describe the parts of a type."""
_AGAIN = 30.0


class Types:
    """The type library for the thread: a type that it lacks is described by rosapi."""

    def __init__(self, library: TypeLibrary, rosapi: Callable[..., Any], *, ros2: bool) -> None:
        self.library = library
        self._ros2 = ros2
        self.problems: dict[str, str] = {}
        self._rosapi = rosapi
        self._missing: dict[str, float] = {}

    async def schema(self, ref: TypeRef, until: float) -> Schema:
        """Return the schema of a type. Raises UnknownType."""
        loop = asyncio.get_running_loop()
        try:
            return await loop.run_in_executor(None, self.library.find, ref)
        except UnknownType as unknown:
            if ref.hash is not None or time.monotonic() < self._missing.get(ref.name, 0.0):
                raise
            try:
                return await self._described(ref.name, until)
            except (RosError, ValueError) as error:
                self._missing[ref.name] = time.monotonic() + _AGAIN
                raise UnknownType(f"{unknown.sentence}; rosapi does not describe it: {error}") from error

    async def message(self, type: TypeRef, until: float) -> MessageSchema:
        """Return the schema of a message type. Raises UnknownType."""
        schema = await self.schema(type, until)
        if not isinstance(schema, MessageSchema):
            raise UnknownType(f"{type.name} is not a message type")
        return schema

    async def _described(self, name: str, until: float) -> Schema:
        whole = enclosing_type(name) or name
        kind = written_form(whole)
        with contextlib.suppress(Refused):  # ROS 1's rosapi has no such service
            # In ROS 2, nodes of rosapi before August 2026 end when they are asked for a type that is not installed.
            if whole not in (await self._rosapi("interfaces", {}, until)).get("interfaces", ()):
                raise ValueError("the robot has no such type")
        texts = []
        for service in _DETAILS[kind]:
            answer = await self._rosapi(service, {"type": whole if self._ros2 else ros1_name(whole)}, until)
            texts.append(definition_of(answer.get("typedefs", ())))
        parts, nested = zip(*(text.partition("\n===")[::2] for text in texts), strict=True)
        text = "\n---\n".join(parts) + "".join(f"\n==={each}" for each in nested if each)
        loop = asyncio.get_running_loop()
        learnt = await loop.run_in_executor(None, self.library.learn_as[kind], whole, text, None)
        return learnt if whole == name else self.library.find(TypeRef(name))


class Client:
    """Connection to a bridge, with the types and the encoding of its version of ROS (None until it is known)."""

    def __init__(self, source: BridgeSource, version: int | None, options: AdapterOptions, session: Session) -> None:
        self.version = version
        self.is_connected = False
        self.connection = BridgeConnection("rosbridge server", source, session, options.message_limit)
        self._calls = Calls()
        self._ids = itertools.count(1)
        self._folders = options.types

    def use_version(self, version: int) -> None:
        """Read and write messages of this version of ROS."""
        self.library = TypeLibrary(ros_version=1 if version == 1 else 2, folders=self._folders)
        self.encoding = Encoding.ROS1 if version == 1 else Encoding.CDR
        self.types = Types(self.library, self.rosapi, ros2=version == 2)
        self.messages = LibraryMessages(self.library)

    async def detected_version(self) -> int:
        """Return the bridge's version of ROS: as rosapi reports it, else by the names of types. Raises RosError."""
        until = asyncio.get_running_loop().time() + _ANSWER_SECONDS
        try:
            return int((await self.rosapi("get_ros_version", {}, until))["version"])
        except (Refused, KeyError, TypeError, ValueError):
            types = (await self.rosapi("topics", {}, until)).get("types", [])
            return 2 if any("/msg/" in each for each in types) else 1

    def type_name(self, name: str) -> str:
        """Return the name of a type as the bridge's version of ROS writes it."""
        return ros1_name(name) if self.encoding is Encoding.ROS1 else name

    def plain(self, schema: MessageSchema, message: object) -> dict[str, Any]:
        """Return a message as the bridge's version of ROS writes it in JSON."""
        return plain_of(schema, message, ros1=self.encoding is Encoding.ROS1)

    def send(self, message: Mapping[str, Any]) -> None:
        """Send a message. Raises Unreachable."""
        self.connection.send(encode_message(message))

    def try_to_send(self, message: Mapping[str, Any]) -> None:
        """Send a message, unless there is no connection."""
        with contextlib.suppress(Unreachable):
            self.send(message)

    async def request(self, service: str, args: Mapping[str, Any], until: float) -> Any:
        """Return the values in the response of a service. Raises Refused, TimedOut, Unreachable."""
        left = until - asyncio.get_running_loop().time()
        if left <= 0:
            raise TimedOut(f"the deadline passed before {service} was called")
        id = f"call_service:{service}:{next(self._ids)}"
        message: dict[str, Any] = {"op": "call_service", "id": id, "service": service, "args": args}
        if until != math.inf:
            message["timeout"] = left
        self.send(message)
        answer = await self._calls.answer(id, service, until)
        if answer.get("result") is False:
            values = answer.get("values")
            words = values if isinstance(values, str) else None
            if words and "imeout" in words:
                raise TimedOut(f"{service} did not answer in time", words=words, sent=Sent.MAYBE)
            raise Refused(f"{service} failed", words=words, sent=Sent.YES)
        return answer.get("values")

    async def rosapi(self, service: str, args: Mapping[str, Any], until: float) -> Any:
        """Return the response of a service of rosapi. Raises Refused, TimedOut, Unreachable."""
        return await self.request(f"/rosapi/{service}", args, until) or {}

    async def call(self, service: str, type: str, request: object, until: float) -> Message:
        """Return the response of a service of a known type. Raises Refused, TimedOut, Unreachable, UnknownType."""
        answer = await self.request(service, self.plain(self.messages.schema(type, "Request"), request), until)
        try:
            return message_of(self.messages.schema(type, "Response"), answer or {})
        except ValueError as error:
            raise Refused(f"the response of {service} cannot be read: {error}", sent=Sent.YES) from error

    def settle(self, response: Mapping[str, Any]) -> None:
        """Process the response of a service."""
        self._calls.settle(response.get("id"), response)

    def fail(self) -> None:
        """Fail all pending requests."""
        self.is_connected = False
        self._calls.fail("the connection to the rosbridge server was lost before the answer")
