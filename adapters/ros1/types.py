"""Types: learnt from connection headers, or found in a local ROS; the graph shows unreadable ones."""

from __future__ import annotations

import asyncio
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from pathlib import Path
from typing import NamedTuple, TypeVar

from rosld.adapters.model import Schema, ServiceSchema, TypeRef, UnknownType
from rosld.adapters.model.library import TypeLibrary

_Key = TypeVar("_Key")
_Fact = TypeVar("_Fact")
_ROS_NAME = re.compile(r"([A-Za-z]\w*)/([A-Za-z]\w*)\Z", re.ASCII)


def type_name(ros_name: str, kind: str = "msg") -> str | None:
    """Return `std_msgs/msg/String` for `std_msgs/String`, or None for an invalid name."""
    match = _ROS_NAME.match(ros_name)
    return f"{match[1]}/{kind}/{match[2]}" if match else None


def ros_name(name: str) -> str:
    """Return ROS 1's name of a type: `std_msgs/String` for `std_msgs/msg/String`."""
    package, _, short = name.partition("/")
    return f"{package}/{short.partition('/')[2] or short}"


def definition_folders(folders: Iterable[Path], environment: Mapping[str, str] = os.environ) -> Sequence[Path]:
    """Return the folders that may contain definitions: those given, then those of a local ROS installation.

    These are `ROS_PACKAGE_PATH`, `/usr/share` (Debian's packages) and `/opt/ros/*/share`; in folders named `share`,
    which contain the whole system's data, only the `msg` and `srv` folders of packages are searched.
    """
    sources = [Path(each) for each in environment.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if each]
    shares = [Path("/usr/share"), *sorted(Path("/opt/ros").glob("*/share"), reverse=True)]
    shares += [each for each in sources if each.name == "share"]
    candidates = [*folders, *(each for each in sources if each.name != "share")]
    for share in dict.fromkeys(shares):
        candidates += [folder for kind in ("msg", "srv") for folder in sorted(share.glob(f"*/{kind}"))]
    return [folder for folder in candidates if folder.is_dir()]


class Types:
    """The type library for the reading thread, which never waits for a definition to be parsed.

    `changed` is called on the reading thread when a type was found to be readable or unreadable.
    """

    def __init__(self, library: TypeLibrary, changed: Callable[[], None]) -> None:
        self.library = library
        self.unreadable: dict[TypeRef, str] = {}
        self._changed = changed
        self._learning: dict[TypeRef, asyncio.Task[None]] = {}
        self._readable: set[TypeRef] = set()

    def learn(self, ref: TypeRef, definition: str) -> None:
        """Start learning a message type from a connection header; called on the reading thread."""
        if ref not in self._readable and ref not in self._learning and ref not in self.unreadable:
            self._learning[ref] = asyncio.get_running_loop().create_task(self._learn(ref, definition))

    async def schema(self, ref: TypeRef) -> Schema:
        """Return the schema of a type; waits if it is being learnt. Raises UnknownType."""
        for pending in [task for each, task in self._learning.items() if each.name == ref.name]:
            await asyncio.shield(pending)
        if ref in self.unreadable:
            raise UnknownType(f"the definition of {ref.name} cannot be read: {self.unreadable[ref]}")
        return await asyncio.get_running_loop().run_in_executor(None, self.library.find, ref)

    async def service(self, ref: TypeRef) -> ServiceSchema:
        """Return the schema of a service type. Raises UnknownType."""
        schema = await self.schema(ref)
        if not isinstance(schema, ServiceSchema):
            raise UnknownType(f"{ref.name} is not a service type")
        return schema

    async def _learn(self, ref: TypeRef, definition: str) -> None:
        loop = asyncio.get_running_loop()
        try:
            await loop.run_in_executor(None, self.library.learn_message, ref.name, definition, ref.hash)
            self._readable.add(ref)
        except Exception as error:  # any error of a hostile definition: the topic stays listed
            self.unreadable[ref] = str(error) or type(error).__name__
        finally:
            del self._learning[ref]
            self._changed()


class EndpointFacts(NamedTuple):
    """A publisher's connection header, or the reason why the connection failed."""

    type: TypeRef | None = None
    latched: bool = False
    unreachable: str | None = None


class ServiceFacts(NamedTuple):
    """Type of a service as reported by its node, or the reason why it cannot be called."""

    type: TypeRef | None = None
    uncallable: str | None = None


class Known(dict[_Key, _Fact]):
    """Facts by key; written only on the reading thread. `changed` is called after each change."""

    def __init__(self, changed: Callable[[], None]) -> None:
        self._changed = changed

    def put(self, key: _Key, fact: _Fact | None) -> None:
        """Set a fact, or forget it."""
        if self.get(key) != fact:
            if fact is None:
                del self[key]
            else:
                self[key] = fact
            self._changed()

    def retain(self, keys: Set[_Key]) -> None:
        """Remove facts about things that the master no longer lists."""
        for key in self.keys() - keys:
            del self[key]


class Facts:
    """Facts about nodes and services by name, and about publishers by topic and node."""

    def __init__(self, changed: Callable[[], None]) -> None:
        self.uris: Known[str, str] = Known(changed)
        self.unreachable: Known[str, str] = Known(changed)
        self.endpoints: Known[tuple[str, str], EndpointFacts] = Known(changed)
        self.services: Known[str, ServiceFacts] = Known(changed)

    def set_node_uri(self, node: str, uri: str) -> None:
        """Set the address of a node."""
        if self.uris.get(node) != uri:
            self.unreachable.pop(node, None)
            self.uris.put(node, uri)
