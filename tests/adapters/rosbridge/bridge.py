"""A rosbridge server for tests, written from the protocol's document, for an embedded robot as ROS 1 or ROS 2."""

from __future__ import annotations

import asyncio
import json
import secrets
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from ssl import SSLContext
from typing import Any

from rosld.adapters.base import Adapter, NullSink
from rosld.adapters.model import Encoding, GoalEvent, GoalId, GoalStatus, MessageSchema, RosError, TypeRef
from rosld.adapters.model.plain import LibraryMessages, message_of, plain_of
from rosld.adapters.parameter_messages import from_message, to_fields

NODE, ROSAPI = "/rosbridge_websocket", "/rosapi"
_PARAMETER_SERVICES = ("list_parameters", "get_parameters", "set_parameters_atomically")
_NUMBERS = {each: number for number, each in enumerate(list(GoalStatus)[:6], 1)}


def cbor(value: Any) -> bytes:
    """Return a value as CBOR: numbers from 0, bytes, text and objects."""
    kind, size, rest = {int: 0, bytes: 2, str: 3, dict: 5}[type(value)], 0, b""
    if isinstance(value, int):
        size = value
    elif isinstance(value, dict):
        size, rest = len(value), b"".join(cbor(each) for pair in value.items() for each in pair)
    else:
        rest = value.encode() if isinstance(value, str) else value
        size = len(rest)
    if size < 24:
        return bytes([kind * 32 + size]) + rest
    width = next(each for each in range(4) if size < 1 << 8 * (1 << each))
    return bytes([kind * 32 + 24 + width]) + size.to_bytes(1 << width, "big") + rest


class Bridge:
    """The server on a thread of its own. `adapter` creates the robot; `raw` is whether the bridge knows cbor-raw."""

    def __init__(self, adapter: Callable[[], Adapter], *, raw: bool = True, tls: SSLContext | None = None) -> None:
        self._adapter = adapter
        self._tls = tls
        self.raw = raw
        self.without_rosapi = False
        self.port = 0
        self.connections: set[_Connection] = set()
        self.received: list[Mapping[str, Any]] = []
        self._stop: Callable[[], None] = lambda: None
        self._thread: threading.Thread | None = None

    @property
    def source(self) -> str:
        return f"rosbridge://127.0.0.1:{self.port}"

    def start(self) -> None:
        """Listen, on the same port as before."""
        ready: Future[None] = Future()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run(ready)), daemon=True)
        self._thread.start()
        ready.result(30)

    def stop(self) -> None:
        """Close all connections."""
        self._stop()
        if self._thread is not None:
            self._thread.join(10)

    def trace(self) -> object:
        """Return what clients have left."""
        return sorted((kind, topic) for each in self.connections for kind, topic in each.trace())

    async def _run(self, ready: Future[None]) -> None:
        from websockets.asyncio.server import serve

        loop, ended = asyncio.get_running_loop(), asyncio.Event()
        self._stop = lambda: loop.call_soon_threadsafe(ended.set)

        async def handle(socket: Any) -> None:
            connection = _Connection(self, self._adapter(), socket)
            await connection.run()

        async with serve(handle, "127.0.0.1", self.port, compression=None, ssl=self._tls) as server:
            self.port = server.sockets[0].getsockname()[1]
            ready.set_result(None)
            await ended.wait()


class _Connection(NullSink):
    """One client, with a robot of its own."""

    def __init__(self, bridge: Bridge, robot: Adapter, socket: Any) -> None:
        self._bridge, self._robot, self._socket = bridge, robot, socket
        self._encoding = robot.capabilities.encoding
        self._ros2 = self._encoding is Encoding.CDR
        self._library = robot._library  # type: ignore[attr-defined]
        self._messages = LibraryMessages(self._library)
        self._subscriptions: dict[str, Any] = {}
        self._goals: dict[GoalId, tuple[str, str]] = {}
        self._statuses: dict[GoalId, int] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    def trace(self) -> list[tuple[str, str]]:
        advertised = [
            each.name for each in self._robot.graph.topics.values() for of in each.publishers if of.node == "/rosld"
        ]
        return [*(("advertised", each) for each in advertised)]

    async def run(self) -> None:
        await self._robot.open(self, deadline=self._until())
        self._bridge.connections.add(self)
        try:
            async for text in self._socket:
                message = json.loads(text)
                self._bridge.received.append(message)
                operation = getattr(self, "_" + message["op"])
                if message["op"] in ("call_service", "send_action_goal"):
                    self._begin(operation(**message))
                else:
                    await operation(**message)
        finally:
            self._bridge.connections.discard(self)
            await self._robot.close()

    def _begin(self, work: Any) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _send(self, message: Mapping[str, Any]) -> None:
        self._begin(self._socket.send(json.dumps(message)))

    def _until(self) -> float:
        return asyncio.get_running_loop().time() + 10

    def _name(self, ref: TypeRef) -> str:
        return ref.name if self._ros2 else f"{ref.name.split('/')[0]}/{ref.name.split('/')[2]}"

    def _ref(self, type: str, kind: str = "msg") -> TypeRef:
        package, *_, name = type.split("/")
        return TypeRef(f"{package}/{kind}/{name}")

    def _encode(self, schema: MessageSchema, values: Mapping[str, Any]) -> bytes:
        return schema.codec.encode(message_of(schema, values), self._encoding)

    def _plain(self, schema: MessageSchema, data: bytes) -> dict[str, Any]:
        return plain_of(schema, schema.codec.decode(data, self._encoding), ros1=not self._ros2)

    # Topics

    async def _subscribe(self, topic: str, id: str, compression: str = "none", **_: Any) -> None:
        if not self._bridge.raw:
            compression = "none"  # as bridges do with what they do not know
        if topic.endswith("/_action/status"):
            self._subscriptions[topic] = None
            self._send_status(topic)
            return
        subscription = await self._robot.subscribe(topic, depth=50)
        sent: set[tuple[str, int, int]] = set()

        def wake() -> None:
            for sample in subscription.latest():
                if (key := (sample.publisher, sample.epoch, sample.sequence)) not in sent:
                    sent.add(key)
                    self._publish_message(topic, sample.schema, sample.data, compression)

        subscription.watch(wake)
        self._subscriptions[topic] = subscription
        wake()

    def _publish_message(self, topic: str, type: TypeRef, data: bytes, compression: str) -> None:
        if compression == "cbor-raw":
            content = {"bytes": data, "secs": 1, "nsecs": 2}
            self._begin(self._socket.send(cbor({"op": "publish", "topic": topic, "msg": content})))
        else:
            self._send({"op": "publish", "topic": topic, "msg": self._plain(self._library.find(type), data)})

    async def _unsubscribe(self, topic: str, **_: Any) -> None:
        subscription = self._subscriptions.pop(topic, None)
        if subscription is not None:
            subscription.close()

    async def _advertise(self, topic: str, type: str, **_: Any) -> None:
        schema = self._library.find(self._ref(type))
        self._robot._advertise(topic, schema.ref, False)  # type: ignore[attr-defined]

    async def _unadvertise(self, topic: str, **_: Any) -> None:
        await self._robot.unadvertise(topic)

    async def _publish(self, topic: str, msg: Any, **_: Any) -> None:
        [type] = self._robot.graph.topics[topic].types
        schema = self._library.find(type)
        await self._robot.publish(topic, type, self._encode(schema, msg), deadline=self._until())

    # Services

    async def _call_service(self, service: str, id: str, args: Any, **_: Any) -> None:
        answer = {"op": "service_response", "id": id, "service": service, "result": True}
        try:
            answer["values"] = await self._answer(service, args)
        except (RosError, ValueError, KeyError) as error:
            answer |= {"result": False, "values": getattr(error, "words", None) or str(error)}
        self._send(answer)

    async def _answer(self, service: str, args: Any) -> Any:
        node, _, last = service.rpartition("/")
        if node == ROSAPI and self._bridge.without_rosapi:
            raise KeyError(f"Service {service} does not exist")
        if node == ROSAPI:
            return await getattr(self, f"_rosapi_{last}")(**args)
        if last == "get_result":  # as rosbridge_suite does with a service of an action
            package, _, name = self._robot.graph.actions[node.removesuffix("/_action")].type.name.split("/")
            raise ValueError(f"Unable to import srv class {name}_GetResult from package {package}. Caused by it")
        if last == "cancel_goal":
            return await self._cancel(node.removesuffix("/_action"))
        if self._ros2 and last in _PARAMETER_SERVICES:
            return await getattr(self, f"_node_{last}")(node, **args)
        existing = self._robot.graph.services[service]
        schema = self._library.find(existing.type)
        request = self._encode(schema.request, args)
        return self._plain(
            schema.response, await self._robot.call(service, existing.type, request, deadline=self._until())
        )

    async def _rosapi_get_ros_version(self) -> Any:
        return {"version": 2 if self._ros2 else 1, "distro": "test"}

    async def _rosapi_topics(self) -> Any:
        topics = self._robot.graph.topics
        return {"topics": list(topics), "types": [self._name(each.types[0]) for each in topics.values()]}

    async def _rosapi_nodes(self) -> Any:
        return {"nodes": [NODE, ROSAPI, *(each for each in self._robot.graph.nodes if each != "/rosld")]}

    async def _rosapi_node_details(self, node: str) -> Any:
        graph, shown = self._robot.graph, "/rosld" if node == NODE else node
        services = [each.name for each in graph.services.values() if shown in each.providers]
        if self._ros2 and any(each.node == node for each in graph.parameters.values()):
            services += [f"{node}/{each}" for each in _PARAMETER_SERVICES]
        publishing = [each.name for each in graph.topics.values() if any(of.node == shown for of in each.publishers)]
        subscribing = [each.name for each in graph.topics.values() if any(of.node == shown for of in each.subscribers)]
        return {
            "publishing": publishing,
            "subscribing": [*subscribing, *(self._subscriptions if node == NODE else ())],
            "services": services,
        }

    async def _rosapi_topic_type(self, topic: str) -> Any:
        return {"type": self._name(self._robot.graph.topics[topic].types[0])}

    async def _rosapi_services(self) -> Any:
        owners = {each.node for each in self._robot.graph.parameters.values()} if self._ros2 else ()
        return {
            "services": [
                *self._robot.graph.services,
                *(f"{node}/{each}" for node in owners for each in _PARAMETER_SERVICES),
            ]
        }

    async def _rosapi_service_type(self, service: str) -> Any:
        return {"type": self._name(self._robot.graph.services[service].type)}

    async def _rosapi_action_servers(self) -> Any:
        return {"action_servers": list(self._robot.graph.actions)}

    async def _rosapi_action_type(self, action: str) -> Any:
        self._bridge.without_rosapi = True  # it ends, as that of rosbridge_suite 2.4 to 2.7 does

    async def _rosapi_interfaces(self) -> Any:
        if not self._ros2:
            raise KeyError("Service /rosapi/interfaces does not exist")
        return {"interfaces": ["odd_msgs/msg/Odd"]}

    async def _rosapi_message_details(self, type: str) -> Any:
        assert type == "odd_msgs/msg/Odd" or not self._ros2, "rosapi ends where it has no such type"
        return {"typedefs": [_ODD] if type.endswith("Odd") else []}

    async def _rosapi_get_param(self, name: str, default: str) -> Any:
        values = await self._robot.get_parameters([name], deadline=self._until())
        return {"value": json.dumps(values.get(name))}

    async def _rosapi_set_param(self, name: str, value: str) -> Any:
        await self._robot.set_parameters({name: json.loads(value)}, deadline=self._until())

    async def _rosapi_delete_param(self, name: str) -> Any:
        await self._robot.delete_parameters([name], deadline=self._until())

    async def _node_list_parameters(self, node: str, **_: Any) -> Any:
        names = [
            name.removeprefix(f"{node}/") for name, each in self._robot.graph.parameters.items() if each.node == node
        ]
        return {"result": {"names": names}}

    async def _node_get_parameters(self, node: str, names: list[str]) -> Any:
        values = await self._robot.get_parameters([f"{node}/{each}" for each in names], deadline=self._until())
        if len(values) < len(names):
            return {"values": []}
        return {"values": [to_fields(each, values[f"{node}/{each}"]) for each in names]}

    async def _node_set_parameters_atomically(self, node: str, parameters: Any) -> Any:
        schema = self._messages.schema("rcl_interfaces/msg/ParameterValue")
        values = {f"{node}/{each['name']}": from_message(message_of(schema, each["value"])) for each in parameters}
        try:
            await self._robot.set_parameters(values, deadline=self._until())
        except RosError as error:
            return {"result": {"successful": False, "reason": error.words or error.sentence}}
        return {"result": {"successful": True}}

    # Actions

    async def _send_action_goal(self, action: str, action_type: str, args: Any, id: str, **_: Any) -> None:
        schema = self._library.find(TypeRef(action_type))
        data = self._encode(schema.goal, args)
        self._sending = id
        try:
            await self._robot.send_goal(action, TypeRef(action_type), data, deadline=self._until())
        except RosError as error:
            self._send(
                {"op": "action_result", "action": action, "id": id, "values": str(error), "status": 0, "result": False}
            )

    async def _cancel_action_goal(self, action: str, id: str, **_: Any) -> None:
        goal = next(goal for goal, (known, _) in self._goals.items() if known == id)
        await self._robot.cancel_goal(goal, deadline=self._until())

    async def _cancel(self, action: str) -> Any:
        await self._robot.cancel_goals(action, deadline=self._until())
        return {"return_code": 0}

    def goal_changed(self, goal: GoalId, event: GoalEvent) -> None:
        id, _ = self._goals.setdefault(goal, (self._sending, secrets.token_hex(16)))
        schema = self._library.find(self._robot.graph.actions[goal.action].type)
        message = {"action": goal.action, "id": id}
        if event.status in _NUMBERS:
            self._statuses[goal] = _NUMBERS[event.status]
            self._send_status(f"{goal.action}/_action/status")
        if event.feedback:
            self._send({"op": "action_feedback", **message, "values": self._plain(schema.feedback, event.feedback)})
        if event.status is not None and event.status.is_final:
            values = self._plain(schema.result, event.result) if event.result else {}
            status = _NUMBERS[event.status]
            self._send({"op": "action_result", **message, "values": values, "status": status, "result": True})

    def _send_status(self, topic: str) -> None:
        if topic in self._subscriptions:
            schema = self._messages.schema("action_msgs/msg/GoalStatusArray")
            listed = [
                {"goal_info": {"goal_id": {"uuid": list(bytes.fromhex(self._goals[goal][1]))}}, "status": status}
                for goal, status in self._statuses.items()
                if f"{goal.action}/_action/status" == topic
            ]
            if listed:  # a server says nothing before its first goal
                self._publish_message(topic, schema.ref, self._encode(schema, {"status_list": listed}), "cbor-raw")


_ODD = {
    "type": "odd_msgs/Odd",
    "fieldnames": ["stamp", "names", "pair"],
    "fieldtypes": ["builtin_interfaces/Time", "string", "float64"],
    "fieldarraylen": [-1, 0, 2],
}
