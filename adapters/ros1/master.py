"""The master: its API, each response checked before it is used."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from rosld.adapters.model import NotFound, Refused, RosError, Sent, Unreachable
from rosld.adapters.model.names import global_name
from rosld.adapters.model.parameter import ParameterValue
from rosld.adapters.ros1.graph import SystemState
from rosld.adapters.ros1.xmlrpc import Answer, XmlRpcClient, encode_call

LOOK = 5.0  # seconds without a response to a poll after which the master counts as lost


class MasterSnapshot(Struct, frozen=True):
    """State of the master: its process id, and the raw responses, which are compared to detect changes."""

    pid: int
    state: bytes
    types: bytes


class MasterApi:
    """Client of ROS 1's Master API at one URI, with `caller` as our name."""

    def __init__(self, client: XmlRpcClient, caller: str) -> None:
        self._client = client
        self._caller = caller

    @property
    def uri(self) -> str:
        """URI of the master as in ROS_MASTER_URI."""
        return self._client.uri

    def close(self) -> None:
        """Close idle connections."""
        self._client.close()

    async def snapshot(self) -> MasterSnapshot:
        """Return the master's process id and state. Raises Unreachable, TimedOut."""
        pid = await self._client.call("getPid", self._caller, timeout=LOOK)
        state = await self._client.request(encode_call("getSystemState", self._caller), timeout=LOOK)
        types = await self._client.request(encode_call("getTopicTypes", self._caller), timeout=LOOK)
        return MasterSnapshot(pid.value if isinstance(pid.value, int) else 0, state, types)

    def system_state(self, snapshot: MasterSnapshot) -> SystemState:
        """Return the decoded system state. Raises Unreachable if it is not from a ROS master."""
        state = self._client.decode(snapshot.state)
        types = self._client.decode(snapshot.types)
        if state.code != 1 or types.code != 1:
            words = f"{state.words}, {types.words}"
            raise Unreachable(f"the master at {self.uri} does not tell its state", words=words)
        try:
            publishers, subscribers, services = (_nodes_by_name(part) for part in _list(state.value))
            return SystemState(publishers, subscribers, services, _types_by_name(types.value))
        except ValueError as error:
            raise Unreachable(f"{self.uri} does not answer as a ROS 1 master does: {error}") from error

    async def parameters_document(self) -> bytes:
        """Return the document of the whole parameter tree."""
        return await self._client.request(encode_call("getParam", self._caller, "/"), timeout=4 * LOOK)

    def parameter_tree(self, document: bytes) -> dict[str, ParameterValue]:
        """Return the decoded tree of such a document."""
        answer = self._client.decode(document)
        return answer.value if answer.code == 1 and isinstance(answer.value, dict) else {}

    async def lookup_node(self, node: str, timeout: float = LOOK) -> str:
        """Return a node's own URI. Raises NotFound."""
        return str(await self._call("lookupNode", node, timeout=timeout))

    async def lookup_service(self, service: str, timeout: float = LOOK) -> str:
        """Return a service's URI (`rosrpc://host:port`). Raises NotFound."""
        return str(await self._call("lookupService", service, timeout=timeout))

    async def register_publisher(self, topic: str, type_name: str, uri: str, timeout: float) -> list[str]:
        """Register as a publisher; return the URIs of the topic's subscribers."""
        value = await self._call("registerPublisher", topic, type_name, uri, timeout=timeout)
        return [str(each) for each in value] if isinstance(value, list) else []

    async def unregister_publisher(self, topic: str, uri: str, timeout: float, *, node: str | None = None) -> None:
        """Unregister a publisher of ours, or of another `node`, at this URI. Does nothing if it is not registered."""
        await self._call("unregisterPublisher", topic, uri, timeout=timeout, caller=node)

    async def get_parameter(self, name: str, timeout: float) -> ParameterValue:
        """Return a parameter's value, or a tree. Raises NotFound."""
        return await self._call("getParam", name, timeout=timeout)

    async def set_parameter(self, name: str, value: ParameterValue, timeout: float) -> None:
        """Set a parameter."""
        await self._call("setParam", name, value, timeout=timeout)

    async def delete_parameter(self, name: str, timeout: float) -> None:
        """Delete a parameter or a tree. Raises NotFound."""
        await self._call("deleteParam", name, timeout=timeout)

    async def _call(
        self, method: str, *arguments: ParameterValue, timeout: float, caller: str | None = None
    ) -> ParameterValue:
        answer = await self._client.call(method, caller or self._caller, *arguments, timeout=timeout)
        if answer.code != 1:
            raise _error(method, arguments[0], answer)
        return answer.value


def _error(method: str, subject: ParameterValue, answer: Answer) -> RosError:
    """Return the error for a code other than 1: -1 is an unknown name, 0 a failure of the master."""
    if answer.code == -1:
        return NotFound(f"the master knows no {subject!r}", words=answer.words)
    return Refused(f"the master refused {method} of {subject!r}", words=answer.words, sent=Sent.YES)


def _list(value: ParameterValue) -> list[ParameterValue]:
    if not isinstance(value, list):
        raise ValueError(f"expected a list, not {str(value)[:40]!r}")
    return value


def _name(value: ParameterValue) -> str:
    return global_name(str(value))


def _nodes_by_name(value: ParameterValue) -> Mapping[str, tuple[str, ...]]:
    pairs = (_list(pair) for pair in _list(value))
    return {_name(name): tuple(dict.fromkeys(_name(node) for node in _list(nodes))) for name, nodes in pairs}


def _types_by_name(value: ParameterValue) -> Mapping[str, str]:
    pairs = (_list(pair) for pair in _list(value))
    return {_name(name): str(type_name) for name, type_name in pairs}
