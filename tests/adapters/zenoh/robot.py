"""Nodes that speak like rmw_zenoh, written from its design document on zenoh itself, and a router of zenoh."""

from __future__ import annotations

import itertools
import json
import struct
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from rosld.adapters.model import Encoding, MessageSchema, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.model.plain import message_of
from rosld.adapters.parameter_messages import from_message, to_fields

RELIABLE, LATCHED = "::,10:,:,:,,", ":1:,1:,:,:,,"
"""Profiles as tokens have them."""
DOMAIN = 7


def configuration(mode: str, **endpoints: str) -> Any:
    """Return a configuration that looks for nothing beyond the given endpoints (`listen`, `connect`)."""
    import zenoh

    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("timestamping/enabled", "true")
    for kind, endpoint in endpoints.items():
        config.insert_json5(f"{kind}/endpoints", json.dumps([endpoint]))
    return config


class Robot:
    """A router on a port, and nodes in a session of their own."""

    def __init__(self, port: int) -> None:
        self.endpoint = f"tcp/127.0.0.1:{port}"
        self.source = f"zenoh://127.0.0.1:{port}?domain={DOMAIN}"
        self.received: list[bytes] = []
        self.parameters: dict[str, Any] = {"name": "Ada", "seats": 2}
        self._library = TypeLibrary(ros_version=2)
        self._router: Any = None

    def start(self) -> None:
        """Start the router and the nodes."""
        import zenoh

        self._router = zenoh.open(configuration("router", listen=self.endpoint))
        self._known: set[str] = set()
        self._router.liveliness().declare_subscriber("@ros2_lv/**", self._discover, history=True)
        self._session = zenoh.open(configuration("client", connect=self.endpoint))
        self._ids = itertools.count(1)
        self._kept: list[Any] = []
        self._ended = threading.Event()
        for node in ("counter", "listener"):
            self._token("NN", node)
        self._publish_numbers("/counter", "std_msgs/msg/Int64")
        self._latched("/description", "std_msgs/msg/String", {"data": "a robot"})
        self._subscribe("/cockpit/display", "std_msgs/msg/String")
        self._serve("/get_power", "std_srvs/srv/Trigger", lambda _: {"message": "off"})
        self._serve("/hangs", "std_srvs/srv/Trigger", lambda _: None)
        for name, answer in {
            "ListParameters": lambda _: {"result": {"names": sorted(self.parameters)}},
            "DescribeParameters": lambda request: {"descriptors": [{"name": each} for each in request.names]},
            "GetParameters": self._get,
            "SetParametersAtomically": self._set,
            "SetParameters": self._delete,
        }.items():
            snake = "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in name)[1:]
            self._serve(f"/listener/{snake}", f"rcl_interfaces/srv/{name}", answer)

    def stop(self) -> None:
        """End the nodes and the router."""
        if self._router is not None:
            self._ended.set()
            self._session.close()
            self._router.close()
            self._router = None

    def tokens(self) -> object:
        """Return the keys of all tokens, once they have stopped changing."""
        known = sorted(self._known)
        while True:
            time.sleep(0.2)
            if (now := sorted(self._known)) == known:
                return known
            known = now

    def _discover(self, sample: Any) -> None:
        key = str(sample.key_expr)
        if str(sample.kind).endswith("DELETE"):
            self._known.discard(key)
        else:
            self._known.add(key)

    def _token(self, kind: str, node: str, topic: str = "", type: TypeRef | None = None, qos: str = RELIABLE) -> None:
        parts = ["@ros2_lv", str(DOMAIN), str(self._session.zid()), "0", str(next(self._ids)), kind, "%", "%", node]
        if type is not None:
            parts += [topic.replace("/", "%"), _dds(type.name), str(type.hash), qos]
        self._kept.append(self._session.liveliness().declare_token("/".join(parts)))

    def _declare(self, kind: str, node: str, topic: str, type: str, qos: str = RELIABLE) -> tuple[str, Any]:
        schema = self._library.find(TypeRef(type))
        self._token(kind, node, topic, schema.ref, qos)
        return f"{DOMAIN}{topic}/{_dds(type)}/{schema.ref.hash}", schema

    def _publish_numbers(self, topic: str, type: str) -> None:
        key, schema = self._declare("MP", "counter", topic, type)
        publisher, ended = self._session.declare_publisher(key), self._ended

        def run() -> None:
            for number in itertools.count(1):
                if ended.wait(0.05):
                    return
                publisher.put(_bytes(schema, {"data": number}), attachment=_attachment(number))

        threading.Thread(target=run, daemon=True).start()

    def _latched(self, topic: str, type: str, values: Mapping[str, object]) -> None:
        import zenoh.ext

        key, schema = self._declare("MP", "counter", topic, type, LATCHED)
        cache = zenoh.ext.CacheConfig(max_samples=1)
        publisher = zenoh.ext.declare_advanced_publisher(self._session, key, cache=cache, publisher_detection=True)
        publisher.put(_bytes(schema, values), attachment=_attachment(1))
        self._kept.append(publisher)

    def _subscribe(self, topic: str, type: str) -> None:
        key, _ = self._declare("MS", "listener", topic, type)
        self._kept.append(self._session.declare_subscriber(key, self._take))

    def _take(self, sample: Any) -> None:
        assert len(sample.attachment.to_bytes()) == 33
        self.received.append(sample.payload.to_bytes())

    def _serve(self, service: str, type: str, answer: Callable[[Any], Mapping[str, object] | None]) -> None:
        key, schema = self._declare("SS", "listener", service, type)

        def respond(query: Any) -> None:
            response = answer(schema.request.codec.decode(query.payload.to_bytes(), Encoding.CDR))
            if response is None:
                self._kept.append(query)  # never answered
            else:
                query.reply(query.key_expr, _bytes(schema.response, response), attachment=query.attachment.to_bytes())
                query.drop()

        self._kept.append(self._session.declare_queryable(key, respond, complete=True))

    def _get(self, request: Any) -> Mapping[str, object]:
        if not self.parameters.keys() >= set(request.names):
            return {"values": []}
        return {"values": [to_fields(each, self.parameters[each]) for each in request.names]}

    def _set(self, request: Any) -> Mapping[str, object]:
        values = {each.name: from_message(each.value) for each in request.parameters}
        if values.get("seats", 0) > 4:
            return {"result": {"successful": False, "reason": "there are four seats at most"}}
        self.parameters |= values
        return {"result": {"successful": True}}

    def _delete(self, request: Any) -> Mapping[str, object]:
        for each in request.parameters:
            self.parameters.pop(each.name, None)
        return {"results": [{"successful": True} for _ in request.parameters]}


def _dds(type: str) -> str:
    package, kind, name = type.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def _bytes(schema: MessageSchema, values: Mapping[str, object]) -> bytes:
    return schema.codec.encode(message_of(schema, values), Encoding.CDR)


def _attachment(number: int) -> bytes:
    return struct.pack("<qqB16s", number, time.time_ns(), 16, b"some id, not ours")
