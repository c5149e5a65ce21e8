"""A participant in a ROS 2 system: subscriptions, publishers, clients, and what the middleware sees.

With `message_classes` and `qos_profiles` it is all that uses rclpy, which is imported when it is first used.

Contexts are our own, never rclpy's global one, so that no signal handler is touched. Topics are read as bytes, taken
from the middleware's own history; there is no executor. What is used here is shared by Humble and all later ROS.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple, Protocol, TypeAlias

from rosld.adapters.model import Qos, TypeRef
from rosld.adapters.model.names import global_name
from rosld.adapters.ros2.message_classes import message_class
from rosld.adapters.ros2.profiles import profile_of_qos, qos_of_profile

_UNKNOWN = "_NODE_NAME_UNKNOWN_"

Names: TypeAlias = Mapping[str, tuple[str, ...]]
"""Names of topics or services to the names of their types."""


class Handle(Protocol):
    """A handle of rclpy's C++ side: entering it keeps it from being destroyed."""

    pointer: int

    def __enter__(self) -> None: ...

    def __exit__(self, *_: object) -> None: ...


class SeenEndpoint(NamedTuple):
    """An endpoint as the middleware knows it; `node` is empty while it does not know whose it is."""

    node: str
    type: TypeRef
    qos: Qos
    gid: bytes


class TakenMessage(NamedTuple):
    """A message as taken: times in nanoseconds of the wall clock, 0 where the middleware does not tell.

    `number` is the publisher's own count of it, and `gid` who sent it; None where the middleware does not tell.
    """

    data: bytes
    source_ns: int
    received_ns: int
    number: int | None
    gid: bytes | None


@dataclass(frozen=True, slots=True)
class ParameterChange:
    """Event of a node: parameters that were added (`new`) or changed, and those deleted."""

    node: str
    set: tuple[str, ...]
    deleted: tuple[str, ...]
    new: tuple[str, ...] = ()


class Reader:
    """A subscription whose messages are taken as bytes. `take` is thread-safe."""

    def __init__(self, node: Any, subscription: Any, qos: Qos) -> None:
        self.handle: Handle = subscription.handle
        self.qos = qos
        self._node = node
        self._subscription = subscription
        self._type = subscription.msg_type
        self._take = subscription.handle.take_message

    def take(self) -> TakenMessage | None:
        """Return the next message in the history; None where there is none, or no longer a subscription."""
        try:
            with self.handle:
                taken = self._take(self._type, True)
        except _invalid_handle():
            return None
        if taken is None:
            return None
        data, info = taken
        gid = info.get("publisher_gid")
        return TakenMessage(
            bytes(data),
            info.get("source_timestamp") or 0,
            info.get("received_timestamp") or time.time_ns(),
            info.get("publication_sequence_number"),
            bytes(gid["data"])[:16] if gid else None,
        )

    def publishers(self) -> int:
        """How many publishers are matched; 1 where rclpy does not tell (Humble)."""
        count = getattr(self._subscription.handle, "get_publisher_count", None)
        return 1 if count is None else int(count())

    def close(self) -> None:
        """End the subscription."""
        self._node.destroy_subscription(self._subscription)


class ParameterEvents:
    """The subscription to `/parameter_events`."""

    def __init__(self, node: Any) -> None:
        kind = message_class("rcl_interfaces/msg/ParameterEvent")
        profile = profile_of_qos(Qos("best_effort", "volatile", "keep_last", 1000))
        self._subscription = node.create_subscription(kind, "/parameter_events", _ignore, profile)
        self.handle: Handle = self._subscription.handle

    def take(self) -> ParameterChange | None:
        """Return the next change in the history, None where there is none."""
        try:
            with self.handle:
                taken = self._subscription.handle.take_message(self._subscription.msg_type, False)
        except _invalid_handle():
            return None
        if taken is None:
            return None
        event = taken[0]
        came = (*event.new_parameters, *event.changed_parameters)
        return ParameterChange(
            global_name(event.node),
            tuple(each.name for each in came),
            tuple(each.name for each in event.deleted_parameters),
            tuple(each.name for each in event.new_parameters),
        )


class Writer:
    """A publisher of serialized messages."""

    def __init__(self, node: Any, publisher: Any, qos: Qos) -> None:
        self.qos = qos
        self._node = node
        self._publisher = publisher

    def publish(self, data: bytes) -> None:
        """Hand over a message. Raises ValueError where the middleware does not take it."""
        try:
            self._publisher.publish(data)
        except Exception as error:
            raise ValueError(str(error)) from error

    def subscribers(self) -> int:
        """How many subscribers are matched, our own reader included."""
        return int(self._publisher.get_subscription_count())

    def close(self) -> None:
        """Stop publishing."""
        self._node.destroy_publisher(self._publisher)


class Client:
    """A client of one service; its answers are taken when its handle is ready."""

    def __init__(self, node: Any, client: Any) -> None:
        self.handle: Handle = client.handle
        self._node = node
        self._client = client

    def ready(self) -> bool:
        """Whether a server is matched."""
        return bool(self._client.service_is_ready())

    def send(self, request: object) -> int:
        """Send a request (an object of the type's class); the number its answer will have."""
        with self.handle:
            return int(self._client.handle.send_request(request))

    def take(self) -> tuple[int, object] | None:
        """Return the next answer with its number, None where there is none."""
        try:
            with self.handle:
                header, response = self._client.handle.take_response(self._client.srv_type.Response)
        except _invalid_handle():
            return None
        return None if header is None else (int(header.request_id.sequence_number), response)

    def close(self) -> None:
        """Give it up."""
        self._node.destroy_client(self._client)


class Wakeup:
    """A guard condition: wakes who waits for it, from any thread."""

    def __init__(self, context: Any) -> None:
        guard = importlib.import_module("rclpy.guard_condition").GuardCondition
        self._guard = guard(None, None, context=context)
        self.handle: Handle = self._guard.handle

    def trigger(self) -> None:
        """Wake."""
        try:
            self._guard.trigger()
        except _invalid_handle():
            pass  # nobody waits any more

    def close(self) -> None:
        """Give it up."""
        self._guard.destroy()


class WaitSet:
    """Waits until one of some handles has something to be taken."""

    def __init__(self, context: Any) -> None:
        self._context = context
        self._implementation = importlib.import_module("rclpy.impl.implementation_singleton").rclpy_implementation
        self._room = (0, 0)
        self._set: Any = None

    def wait(self, readers: Sequence[Handle], clients: Sequence[Handle], wakeup: Handle, seconds: float) -> set[int]:
        """The pointers of the handles that are ready. The handles must be entered."""
        room = (_room(len(readers)), _room(len(clients)))
        if self._set is None or room != self._room:
            self._set = self._implementation.WaitSet(room[0], 1, 0, room[1], 0, 0, self._context.handle)
            self._room = room
        self._set.clear_entities()
        for reader in readers:
            self._set.add_subscription(reader)
        for client in clients:
            self._set.add_client(client)
        self._set.add_guard_condition(wakeup)
        self._set.wait(int(seconds * 1e9))
        ready = self._set.get_ready_entities
        return {*(ready("subscription") if readers else ()), *(ready("client") if clients else ())}


class Participant:
    """Our part in a ROS 2 system: a hidden node that looks, reads and calls, and one that is seen while we publish."""

    def __init__(self, name: str, domain: int | None, namespace: str) -> None:
        context = importlib.import_module("rclpy.context").Context()
        context.init(args=[], initialize_logging=False, domain_id=domain)
        self.context = context
        self.namespace = namespace
        try:
            self._hidden = _node(name, namespace, context)
        except BaseException:
            context.try_shutdown()
            raise
        self._shown: Any = None
        self.hidden_name = _full_name(name, namespace)
        self.shown_name: str | None = None

    def wakeup(self) -> Wakeup:
        """Return a guard condition of this context."""
        return Wakeup(self.context)

    def wait_set(self) -> WaitSet:
        """Return a wait set of this context."""
        return WaitSet(self.context)

    def node_names(self) -> tuple[str, ...]:
        """The nodes that can be seen, ours included; a name is there once for each node that has it."""
        found = self._hidden.get_node_names_and_namespaces()
        return tuple(_full_name(name, namespace) for name, namespace in found if name != _UNKNOWN)

    def topics(self) -> Names:
        """Return the topics and their types, ours included."""
        return {name: tuple(types) for name, types in self._hidden.get_topic_names_and_types()}

    def services(self) -> Names:
        """Return the services and their types."""
        return {name: tuple(types) for name, types in self._hidden.get_service_names_and_types()}

    def services_of(self, node: str) -> Names:
        """Return the services that a node provides."""
        return self._of(self._hidden.get_service_names_and_types_by_node, node)

    def clients_of(self, node: str) -> Names:
        """The services that a node has clients of."""
        return self._of(self._hidden.get_client_names_and_types_by_node, node)

    def counts(self, topic: str) -> tuple[int, int]:
        """Return the numbers of publishers and subscribers of a topic; none for a name that ROS 2 does not allow."""
        try:
            return self._hidden.count_publishers(topic), self._hidden.count_subscribers(topic)
        except Exception:  # each ROS has an error of its own for a name that another's middleware let through
            return 0, 0

    def publishers(self, topic: str) -> tuple[SeenEndpoint, ...]:
        """Return the publishers of a topic."""
        return _endpoints(self._hidden.get_publishers_info_by_topic, topic)

    def subscribers(self, topic: str) -> tuple[SeenEndpoint, ...]:
        """Return the subscribers of a topic, our own included."""
        return _endpoints(self._hidden.get_subscriptions_info_by_topic, topic)

    def show(self, name: str) -> None:
        """Create a node of this name, to publish from."""
        if self._shown is None:
            self._shown = _node(name, self.namespace, self.context)
            self.shown_name = _full_name(name, self.namespace)

    def hide(self) -> None:
        """Take the node that publishes away."""
        if self._shown is not None:
            node, self._shown, self.shown_name = self._shown, None, None
            node.destroy_node()

    def reader(self, topic: str, type: str, qos: Qos) -> Reader:
        """Subscribe. Raises UnknownType, ValueError."""
        events = _no_events("SubscriptionEventCallbacks")
        subscription = self._hidden.create_subscription(
            message_class(type), topic, _ignore, profile_of_qos(qos), event_callbacks=events, raw=True
        )
        return Reader(self._hidden, subscription, qos)

    def writer(self, topic: str, type: str, qos: Qos) -> Writer:
        """Publish, from the node that is shown. Raises UnknownType, ValueError."""
        events = _no_events("PublisherEventCallbacks")
        publisher = self._shown.create_publisher(
            message_class(type), topic, profile_of_qos(qos), event_callbacks=events
        )
        return Writer(self._shown, publisher, qos)

    def client(self, service: str, type: str) -> Client:
        """Return a client of a service. Raises UnknownType, ValueError."""
        return Client(self._hidden, self._hidden.create_client(message_class(type), service))

    def parameter_events(self) -> ParameterEvents:
        """Subscribe to the changes of all nodes' parameters."""
        return ParameterEvents(self._hidden)

    def close(self) -> None:
        """Leave."""
        self.hide()
        self._hidden.destroy_node()
        self.context.try_shutdown()

    def _of(self, ask: Any, node: str) -> Names:
        namespace, _, name = node.rpartition("/")
        try:
            return {each: tuple(types) for each, types in ask(name, namespace or "/")}
        except Exception:  # the node has gone: each ROS has an error of its own for that
            return {}


@cache
def _invalid_handle() -> Any:
    """The error of a handle that was destroyed."""
    return importlib.import_module("rclpy.impl.implementation_singleton").rclpy_implementation.InvalidHandle


def _node(name: str, namespace: str, context: Any) -> Any:
    node = importlib.import_module("rclpy.node").Node
    parameter = importlib.import_module("rclpy.parameter").Parameter
    return node(
        name,
        context=context,
        namespace=namespace,
        use_global_arguments=False,
        enable_rosout=False,
        start_parameter_services=False,
        parameter_overrides=[parameter("start_type_description_service", value=False)],
    )


def _no_events(name: str) -> Any:
    try:
        events = importlib.import_module("rclpy.event_handler")
    except ModuleNotFoundError:  # Humble
        events = importlib.import_module("rclpy.qos_event")
    return getattr(events, name)(use_default_callbacks=False)


def _endpoints(ask: Any, topic: str) -> tuple[SeenEndpoint, ...]:
    try:
        return tuple(map(_endpoint, ask(topic)))
    except Exception:  # as for `counts`
        return ()


def _endpoint(info: Any) -> SeenEndpoint:
    stated = str(getattr(info, "topic_type_hash", ""))
    known = info.node_name != _UNKNOWN
    return SeenEndpoint(
        _full_name(info.node_name, info.node_namespace) if known else "",
        TypeRef(info.topic_type, stated if stated.startswith("RIHS") else None),
        qos_of_profile(info.qos_profile),
        bytes(info.endpoint_gid)[:16],
    )


def _full_name(name: str, namespace: str) -> str:
    return f"{namespace.rstrip('/')}/{name}"


def _room(wanted: int) -> int:
    """Room for some more than are wanted, so that a wait set serves for a while."""
    return 0 if wanted == 0 else 1 << (wanted - 1).bit_length()


def _ignore(_: object) -> None:
    """No executor ever calls this."""
