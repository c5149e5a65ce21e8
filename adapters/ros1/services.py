"""Services: their types are requested from their nodes, and they are called over TCPROS."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable

from rosld.adapters.model import NotFound, Refused, RosError, Sent, TimedOut, TypeRef, UnknownType, Unreachable
from rosld.adapters.ros1.master import Hosts, MasterApi, host_and_port
from rosld.adapters.ros1.tcpros import MAX_HEADER, BadFrame, Header, decode_header, encode_header, frame, read_frame
from rosld.adapters.ros1.types import Facts, ServiceFacts, Types, type_name
from rosld.adapters.thread import Tasks

_AT_ONCE = 4
_PROBE = 5.0
_PROBE_PAUSE = 30.0


class Services:
    """Services of a ROS system. All methods run on the reading thread.

    Responses of more than `message_limit` bytes are rejected.
    """

    def __init__(
        self, caller: str, master: MasterApi, hosts: Hosts, types: Types, facts: Facts, message_limit: int
    ) -> None:
        self._message_limit = message_limit
        self._caller = caller
        self._master = master
        self._hosts = hosts
        self._types = types
        self._known_facts = facts
        self._probed: dict[str, tuple[tuple[str, ...], float]] = {}
        self._few = asyncio.Semaphore(_AT_ONCE)
        self.probes = Tasks()
        """Pending requests for types."""

    def follow(self, services: Iterable[tuple[str, tuple[str, ...]]]) -> None:
        """Request the types of services (with providers) that are new, have moved, or could not be reached."""
        now = asyncio.get_running_loop().time()
        listed = dict(services)
        self._probed = {name: probed for name, probed in self._probed.items() if name in listed}
        for name, providers in listed.items():
            probed = self._probed.get(name)
            unknown = self._known_facts.services.get(name, ServiceFacts()).type is None
            if probed is None or probed[0] != providers or (unknown and now - probed[1] > _PROBE_PAUSE):
                self._probed[name] = providers, now
                self.probes.begin(self._probe(name))

    def forget(self) -> None:
        """Request the types of all services again at the next poll."""
        self._probed.clear()

    async def call(self, service: str, type: TypeRef, request: bytes, until: float) -> bytes:
        """Return the response of a service. Raises Refused with the node's message, TimedOut, Unreachable, NotFound."""
        progress = [Sent.NO]
        left = until - asyncio.get_running_loop().time()
        try:
            return await asyncio.wait_for(self._call(service, type, request, progress), max(left, 0.0))
        except asyncio.TimeoutError as error:
            raise TimedOut(f"{service} did not answer in time", sent=progress[0]) from error
        except (OSError, EOFError) as error:
            self._probed.pop(service, None)
            sent = Sent.NO if progress[0] is Sent.NO else Sent.MAYBE
            words = "its node went away" + (" before the request was sent" if sent is Sent.NO else "")
            raise Unreachable(f"{service} cannot be called: {words}", sent=sent) from error
        except BadFrame as error:
            limit = f" (--setting message_limit is {self._message_limit})" if progress[0] is Sent.YES else ""
            raise Refused(f"the response of {service} cannot be read: {error}{limit}", sent=progress[0]) from error

    async def _call(self, service: str, type: TypeRef, request: bytes, progress: list[Sent]) -> bytes:
        reader, writer = await self._connect(service)
        try:
            md5 = type.hash or (await self._types.service(type)).ref.hash or "*"
            hello = {"callerid": self._caller, "service": service, "md5sum": md5, "persistent": "0"}
            writer.write(encode_header(hello))
            header = decode_header(await read_frame(reader, MAX_HEADER))
            if "error" in header:
                self._probed.pop(service, None)
                raise Refused(f"{service} refuses the call", words=header["error"])
            progress[0] = Sent.YES
            writer.write(frame(request))
            succeeded = await reader.readexactly(1)
            answer = await read_frame(reader, MAX_HEADER if succeeded == b"\0" else self._message_limit)
        finally:
            writer.close()
        if succeeded == b"\0":
            words = answer.decode("utf-8", "replace") or None
            raise Refused(f"{service} failed", words=words, sent=Sent.YES)
        return answer

    async def _connect(self, service: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        try:
            uri = await self._master.lookup_service(service)
        except NotFound as error:
            raise NotFound(f"there is no service {service}", words=error.words) from error
        return await self._hosts.streams(*host_and_port(uri, "rosrpc"))

    async def _probe(self, service: str) -> None:
        async with self._few:
            try:
                facts = await asyncio.wait_for(self._facts(service), _PROBE)
            except (RosError, OSError, EOFError, BadFrame, asyncio.TimeoutError) as error:
                before = self._known_facts.services.get(service, ServiceFacts())
                words = str(error) or "no answer in time"
                facts = ServiceFacts(before.type, f"its node does not report its type: {words}")
            if service in self._probed:
                self._known_facts.services.put(service, facts)

    async def _facts(self, service: str) -> ServiceFacts:
        reader, writer = await self._connect(service)
        try:
            hello = {"callerid": self._caller, "service": service, "md5sum": "*", "probe": "1"}
            writer.write(encode_header(hello))
            header = decode_header(await read_frame(reader, MAX_HEADER))
        finally:
            writer.close()
        return await self._facts_of(header)

    async def _facts_of(self, header: Header) -> ServiceFacts:
        """Return the facts in a service's header, and whether its definition is known."""
        if "error" in header:
            return ServiceFacts(None, f"its node refuses to report its type: {header['error']}")
        name = type_name(header.get("type", ""), "srv")
        if name is None:
            return ServiceFacts(None, f"its node reports the type {header.get('type', '')[:80]!r}")
        ref = TypeRef(name, header.get("md5sum"))
        try:
            schema = await self._types.service(ref)
        except UnknownType as error:
            return ServiceFacts(ref, str(error))
        return ServiceFacts(schema.ref)
