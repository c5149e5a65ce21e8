"""The rosbridge protocol 2.0: its messages as JSON and as CBOR, names of types, and definitions in rosapi's form."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import orjson

from rosld.adapters.model.library import SEPARATOR

_MAX_DEPTH = 8
_IDL_NAMES = {"boolean": "bool", "double": "float64", "float": "float32", "octet": "byte"}


def encode_message(message: Mapping[str, Any]) -> str:
    """Return a protocol message as JSON, with NaN and infinities as Python's parser reads them."""
    return json.dumps(message, separators=(",", ":"))


def decode_message(message: str | bytes) -> Mapping[str, Any]:
    """Return a protocol message: text is JSON, bytes are CBOR. Raises ValueError."""
    if isinstance(message, bytes):
        decoded = _Cbor(message).item()
    else:
        try:
            decoded = orjson.loads(message)
        except ValueError:  # NaN, which JSON does not have
            decoded = json.loads(message)
    if not isinstance(decoded, dict):
        raise ValueError("a message of rosbridge must be an object")
    return decoded


class _Cbor:
    """Reader of the part of CBOR (RFC 8949) that cbor-raw uses: integers, bytes, text, arrays and maps."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def item(self, depth: int = 0) -> Any:
        """Return the next item. Raises ValueError."""
        if depth > _MAX_DEPTH:
            raise ValueError("the CBOR of a message is nested too deep")
        kind, size = divmod(self._take(1)[0], 32)
        if size >= 24:
            if size > 27:
                raise ValueError("the CBOR of a message has items without a length")
            size = int.from_bytes(self._take(1 << (size - 24)), "big")
        match kind:
            case 0:
                return size
            case 1:
                return -1 - size
            case 2:
                return self._take(size)
            case 3:
                return self._take(size).decode()
            case 4:
                return [self.item(depth + 1) for _ in range(self._bounded(size))]
            case 5:
                return {str(self.item(depth + 1)): self.item(depth + 1) for _ in range(self._bounded(size))}
        raise ValueError(f"the CBOR of a message has items of the type {kind}")

    def _bounded(self, count: int) -> int:
        if count > len(self._data) - self._at:
            raise ValueError("the CBOR of a message is truncated")
        return count

    def _take(self, size: int) -> bytes:
        end = self._at + self._bounded(size)
        part, self._at = self._data[self._at : end], end
        return part


def full_name(type: str, kind: str = "msg") -> str:
    """Return `std_msgs/msg/String` for `std_msgs/String`, and names with three parts as they are."""
    package, slash, rest = type.partition("/")
    return type if not slash or "/" in rest else f"{package}/{kind}/{rest}"


def ros1_name(type: str) -> str:
    """Return ROS 1's name of a type: `std_msgs/String` for `std_msgs/msg/String`."""
    package, _, rest = type.partition("/")
    return f"{package}/{rest.partition('/')[2] or rest}"


def definition_of(typedefs: Sequence[Mapping[str, Any]]) -> str:
    """Return the definition of the first type in a list of rosapi/TypeDef, followed by those that it nests.

    Constants are left out, because their types are not stated. Raises ValueError.
    """
    if not typedefs:
        raise ValueError("there is no such type")
    try:
        first, *nested = typedefs
        sections = [f"{SEPARATOR}\nMSG: {ros1_name(each['type'])}\n{_fields(each)}" for each in nested]
        return "\n".join([_fields(first), *sections]) + "\n"
    except (KeyError, TypeError) as error:
        raise ValueError(f"a description of a type cannot be read: {error}") from error


def _fields(typedef: Mapping[str, Any]) -> str:
    columns = (typedef["fieldtypes"], typedef["fieldarraylen"], typedef["fieldnames"])
    return "\n".join(
        f"{_IDL_NAMES.get(type, ros1_name(type) if '/' in type else type)}{_suffix(length)} {name.lstrip('_')}"
        for type, length, name in zip(*columns, strict=True)
        if name != "structure_needs_at_least_one_member"
    )


def _suffix(length: int) -> str:
    return "" if length < 0 else "[]" if length == 0 else f"[{length}]"
