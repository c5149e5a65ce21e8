"""Participant in a ROS 2 system: subscriptions, publishers, clients, and the middleware's view of the system.

Besides `message_classes`, `profiles` and `wait_set`, only this module uses rclpy, which is imported on first use.

Contexts are our own, not rclpy's global one, so that no signal handlers are changed. Topics are read as bytes from the
middleware's own history; there is no executor. All used parts of rclpy exist in Humble and later releases.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple, Protocol, TypeAlias

from rosld.adapters.model import Qos, TypeRef
from rosld.adapters.model.plain import MessageFactory
from rosld.adapters.ros2 import message_classes
from rosld.adapters.ros2.message_classes import message_class
from rosld.adapters.ros2.profiles import profile_of_qos, qos_of_profile

_UNKNOWN = "_NODE_NAME_UNKNOWN_"

Names: TypeAlias = Mapping[str, tuple[str, ...]]
"""Names of topics or services, with the names of their types."""


class Handle(Protocol):
    """A handle of rclpy's C++ part: entering it prevents its destruction."""

    pointer: int

    def __enter__(self) -> None: ...

    def __exit__(self, *_: object) -> None: ...


class DiscoveredEndpoint(NamedTuple):
    """An endpoint known to the middleware; `node` is empty while its node is unknown."""

    node: str
    type: TypeRef
    qos: Qos
    gid: bytes


class ReceivedMessage(NamedTuple):
    """A message as taken: times in nanoseconds (wall clock), 0 if the middleware does not report them.

    `number` is the publisher's sequence number and `gid` its id, None if the middleware does not report them.
    """

    data: bytes
    source_ns: int
    received_ns: int
    number: int | None
    gid: bytes | None


class Reader:
    """A subscription whose messages are taken as bytes. `take` is thread-safe."""

    def __init__(self, node: Any, subscription: Any, qos: Qos) -> None:
        self.handle: Handle = subscription.handle
        self.qos = qos
        self._node = node
        self._subscription = subscription
        self._type = subscription.msg_type
        self._take = subscription.handle.take_message

    def take(self) -> ReceivedMessage | None:
        """Return the next message in the history, or None if there is none or the subscription has ended."""
        try:
            with self.handle:
                message = self._take(self._type, True)
        except invalid_handle():
            return None
        if message is None:
            return None
        data, info = message
        gid = info.get("publisher_gid")
        return ReceivedMessage(
            bytes(data),
            info.get("source_timestamp") or 0,
            info.get("received_timestamp") or time.time_ns(),
            info.get("publication_sequence_number"),
            bytes(gid["data"])[:16] if gid else None,
        )

    def publishers(self) -> int:
        """Return the number of matched publishers; 1 if rclpy does not report it (Humble)."""
        count = getattr(self._subscription.handle, "get_publisher_count", None)
        return 1 if count is None else int(count())

    def close(self) -> None:
        self._node.destroy_subscription(self._subscription)


class Writer:
    """A publisher of serialized messages."""

    def __init__(self, node: Any, publisher: Any, qos: Qos) -> None:
        self.qos = qos
        self._node = node
        self._publisher = publisher

    def publish(self, data: bytes) -> None:
        """Publish a message. Raises ValueError if the middleware refuses it."""
        try:
            self._publisher.publish(data)
        except Exception as error:
            raise ValueError(str(error)) from error

    def subscribers(self) -> int:
        """Return the number of matched subscribers, including our own reader."""
        return int(self._publisher.get_subscription_count())

    def close(self) -> None:
        """Stop publishing."""
        self._node.destroy_publisher(self._publisher)


class Client:
    """A client of one service, whose responses can be taken when its handle is ready."""

    def __init__(self, node: Any, client: Any) -> None:
        self.handle: Handle = client.handle
        self._node = node
        self._client = client

    def ready(self) -> bool:
        """Whether a server is matched."""
        return bool(self._client.service_is_ready())

    def send(self, request: object) -> int:
        """Send a request (an object of the type's class); return the number of its response."""
        with self.handle:
            return int(self._client.handle.send_request(request))

    def take(self) -> tuple[int, object] | None:
        """Return the next response with its number, or None."""
        try:
            with self.handle:
                header, response = self._client.handle.take_response(self._client.srv_type.Response)
        except invalid_handle():
            return None
        return None if header is None else (int(header.request_id.sequence_number), response)

    def close(self) -> None:
        self._node.destroy_client(self._client)


class Participant:
    """Our participant in a ROS 2 system: a hidden node for reading and calling, and a visible one while we publish."""

    def __init__(self, name: str, domain: int | None, namespace: str) -> None:
        context = importlib.import_module("rclpy.context").Context()
        context.init(args=[], initialize_logging=False, domain_id=domain)
        self.context = context
        self.messages: MessageFactory = message_classes
        self.namespace = namespace
        try:
            self._hidden = _node(name, namespace, context)
        except BaseException:
            context.try_shutdown()
            raise
        self._visible: Any = None
        self.hidden_name = _full_name(name, namespace)
        self.visible_name: str | None = None

    def node_names(self) -> tuple[str, ...]:
        """Return the visible nodes, including ours; a name is repeated if several nodes have it."""
        found = self._hidden.get_node_names_and_namespaces()
        return tuple(_full_name(name, namespace) for name, namespace in found if name != _UNKNOWN)

    def topics(self) -> Names:
        """Return the topics and their types, including ours."""
        return {name: tuple(types) for name, types in self._hidden.get_topic_names_and_types()}

    def services(self) -> Names:
        """Return the services and their types."""
        return {name: tuple(types) for name, types in self._hidden.get_service_names_and_types()}

    def services_of(self, node: str) -> Names:
        """Return the services that a node provides."""
        return self._of(self._hidden.get_service_names_and_types_by_node, node)

    def clients_of(self, node: str) -> Names:
        """Return the services that a node has clients of."""
        return self._of(self._hidden.get_client_names_and_types_by_node, node)

    def counts(self, topic: str) -> tuple[int, int]:
        """Return the numbers of publishers and subscribers of a topic; zeros for a name that ROS 2 does not allow."""
        try:
            return self._hidden.count_publishers(topic), self._hidden.count_subscribers(topic)
        except Exception:  # releases raise different errors for a name that another middleware accepts
            return 0, 0

    def publishers(self, topic: str) -> tuple[DiscoveredEndpoint, ...]:
        """Return the publishers of a topic."""
        return _endpoints(self._hidden.get_publishers_info_by_topic, topic)

    def subscribers(self, topic: str) -> tuple[DiscoveredEndpoint, ...]:
        """Return the subscribers of a topic, including ours."""
        return _endpoints(self._hidden.get_subscriptions_info_by_topic, topic)

    def show(self, name: str) -> None:
        """Create a visible node of this name, to publish from."""
        if self._visible is None:
            self._visible = _node(name, self.namespace, self.context)
            self.visible_name = _full_name(name, self.namespace)

    def hide(self) -> None:
        """Remove the visible node."""
        if self._visible is not None:
            node, self._visible, self.visible_name = self._visible, None, None
            node.destroy_node()

    def reader(self, topic: str, type: str, qos: Qos) -> Reader:
        """Return a new subscription. Raises UnknownType, ValueError."""
        events = _no_events("SubscriptionEventCallbacks")
        subscription = self._hidden.create_subscription(
            message_class(type), topic, _ignore, profile_of_qos(qos), event_callbacks=events, raw=True
        )
        return Reader(self._hidden, subscription, qos)

    def writer(self, topic: str, type: str, qos: Qos) -> Writer:
        """Return a new publisher of the visible node. Raises UnknownType, ValueError."""
        events = _no_events("PublisherEventCallbacks")
        publisher = self._visible.create_publisher(
            message_class(type), topic, profile_of_qos(qos), event_callbacks=events
        )
        return Writer(self._visible, publisher, qos)

    def client(self, service: str, type: str) -> Client:
        """Return a new client of a service. Raises UnknownType, ValueError."""
        return Client(self._hidden, self._hidden.create_client(message_class(type), service))

    def close(self) -> None:
        """Leave the system."""
        self.hide()
        self._hidden.destroy_node()
        self.context.try_shutdown()

    def _of(self, query: Any, node: str) -> Names:
        namespace, _, name = node.rpartition("/")
        try:
            return {each: tuple(types) for each, types in query(name, namespace or "/")}
        except Exception:  # the node has disappeared, for which releases raise different errors
            return {}


@cache
def invalid_handle() -> Any:
    """Return the class of the error about a destroyed handle."""
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


def _endpoints(query: Any, topic: str) -> tuple[DiscoveredEndpoint, ...]:
    try:
        return tuple(map(_endpoint, query(topic)))
    except Exception:  # see `counts`
        return ()


def _endpoint(info: Any) -> DiscoveredEndpoint:
    stated = str(getattr(info, "topic_type_hash", ""))
    has_node = info.node_name != _UNKNOWN
    return DiscoveredEndpoint(
        _full_name(info.node_name, info.node_namespace) if has_node else "",
        TypeRef(info.topic_type, stated if stated.startswith("RIHS") else None),
        qos_of_profile(info.qos_profile),
        bytes(info.endpoint_gid)[:16],
    )


def _full_name(name: str, namespace: str) -> str:
    return f"{namespace.rstrip('/')}/{name}"


def _ignore(_: object) -> None:
    """Do nothing: no executor calls this."""
