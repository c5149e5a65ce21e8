"""Types: defined by installed packages, by the user's folders, or by the nodes that use them.

A node describes a type (REP 2016) by its sources or, without constants and comments, by names, types and default values
of fields, which are written as a definition.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from rosld.adapters.model import RosError, Schema, TypeRef, UnknownType
from rosld.adapters.model.definition import written_form
from rosld.adapters.model.library import SEPARATOR, TypeLibrary
from rosld.adapters.model.schema import BOUNDED_STRINGS, DUMMY, PRIMITIVES
from rosld.adapters.ros2.calls import Calls

_DESCRIPTION = "type_description_interfaces/srv/GetTypeDescription"
_KINDS = ("msg", "srv", "action")
_MAX_QUERIED = 3


def definition_folders(
    folders: Iterable[Path], environment: Mapping[str, str] = os.environ, prefix: str = sys.prefix
) -> Sequence[Path]:
    """Return the folders that may contain definitions: those given, then the share folders of the sourced ROS.

    For wheels, the share folder of the virtual environment.
    """
    prefixes = [each for each in environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if each]
    shares = [Path(each) / "share" for each in (*prefixes, prefix)]
    candidates = list(folders)
    for share in dict.fromkeys(shares):
        if (share / "ament_index").is_dir() or share.parent != Path(prefix):
            candidates += [folder for kind in _KINDS for folder in sorted(share.glob(f"*/{kind}"))]
    return [folder for folder in candidates if folder.is_dir()]


class Types:
    """The type library for the ROS thread."""

    def __init__(self, library: TypeLibrary, calls: Calls) -> None:
        self.library = library
        self._calls = calls
        self._problems: dict[str, str | None] = {}
        self._hashes: dict[str, str | None] = {}

    def problem(self, name: str) -> str | None:
        """Return why messages of a type cannot be read or sent here, or None."""
        if name not in self._problems:
            self._problems[name] = self._calls.messages.class_problem(name)
        return self._problems[name]

    def note_problem(self, name: str, words: str) -> None:
        """Record why messages of a type cannot be decoded."""
        self._problems[name] = words

    def with_hash(self, ref: TypeRef) -> TypeRef:
        """Return the type with the local definition's hash if the middleware reports none (Humble)."""
        if ref.hash is not None:
            return ref
        if ref.name not in self._hashes:
            try:
                self._hashes[ref.name] = self.library.find(ref).ref.hash
            except UnknownType:
                self._hashes[ref.name] = None
        return TypeRef(ref.name, self._hashes[ref.name])

    async def schema(self, ref: TypeRef, users: Sequence[str], until: float) -> Schema:
        """Return the schema of a type: from local definitions, else, if its hash is known, from the nodes that use it.

        Raises UnknownType.
        """
        loop = asyncio.get_running_loop()
        try:
            return await loop.run_in_executor(None, self.library.find, ref)
        except UnknownType as unknown:
            for node in users[:_MAX_QUERIED]:
                if (found := await self._query(node, ref, until)) is not None:
                    return found
            raise unknown

    async def _query(self, node: str, ref: TypeRef, until: float) -> Schema | None:
        """Return a node's description of a type with a known hash, or None."""
        if ref.hash is None:
            return None
        fields: dict[str, object] = {"type_name": ref.name, "type_hash": ref.hash, "include_type_sources": True}
        service = f"{node}/get_type_description"
        try:
            request = self._calls.messages.make_message(_DESCRIPTION, fields, "Request")
            answer = cast(Any, await self._calls.call(service, _DESCRIPTION, request, until))
            if not answer.successful:
                return None
            return await asyncio.get_running_loop().run_in_executor(None, self._learn, ref, answer)
        except (RosError, ValueError):
            return None

    def _learn(self, ref: TypeRef, answer: Any) -> Schema:
        """Return the schema in a node's response: from sources, which have constants and comments, else as described.

        Raises ValueError if neither can be read or has the right hash.
        """
        sources = {each.type_name: (each.encoding, each.raw_file_contents) for each in answer.type_sources}
        kind = written_form(ref.name)
        encoding, text = sources.pop(ref.name, ("", ""))
        learn = self.library.learn_as[kind]
        if encoding == kind:
            with contextlib.suppress(ValueError):
                return learn(ref.name, _with_nested(text, sources), ref.hash)
        described = answer.type_description
        text = definition_of(ref.name, [described.type_description, *described.referenced_type_descriptions])
        return learn(ref.name, text, ref.hash)


def _with_nested(text: str, sources: Mapping[str, tuple[str, str]]) -> str:
    """Return a definition with those of the messages that it may nest appended."""
    parts = [text.rstrip("\n")]
    for name, (kind, nested) in sources.items():
        if kind == "msg":
            parts.append(f"{SEPARATOR}\nMSG: {name.replace('/msg/', '/')}\n{nested.rstrip()}")
    return "\n".join(parts) + "\n"


_NESTED, _BLOCK = 1, 48
_PRIMITIVES = {number: name for name, number in PRIMITIVES.items() if name != "char"}
_BOUNDED = {number: name for name, number in BOUNDED_STRINGS.items()}
_SUFFIXES = ("", "[{}]", "[<={}]", "[]")
"""Suffixes of a single value, an array, a bounded and an unbounded sequence, whose ids are 48 apart."""
_PARTS: Mapping[str, tuple[str, ...]] = {
    "msg": ("",),
    "srv": ("_Request", "_Response"),
    "action": ("_Goal", "_Result", "_Feedback"),
}


def definition_of(name: str, described: Iterable[Any]) -> str:
    """Return the definition of a message, service or action, with the messages that it nests appended.

    `described` are the type and all that it refers to (type_description_interfaces/msg/IndividualTypeDescription).
    Raises ValueError naming a type that is missing or impossible.
    """
    fields = {each.type_name: each.fields for each in described}
    parts = [f"{name}{end}" for end in _PARTS[written_form(name)]]
    lacking = [part for part in parts if part not in fields]
    if lacking:
        raise ValueError(f"the description of {name} lacks {lacking[0]}")
    whole = "\n---\n".join(_text(fields[part]) for part in parts)
    nested = [each for each in _types_within(parts, fields) if each not in parts]
    return "\n".join([whole, *(f"{SEPARATOR}\nMSG: {_short(each)}\n{_text(fields[each])}" for each in nested)]) + "\n"


def _types_within(parts: Sequence[str], fields: Mapping[str, Sequence[Any]]) -> list[str]:
    """Return these types and all that they nest. Raises ValueError if one is not described."""
    visited: dict[str, None] = {}
    pending = list(parts)
    while pending:
        name = pending.pop()
        if name in visited:
            continue
        if name not in fields:
            raise ValueError(f"the description of {parts[0]} lacks {name}")
        visited[name] = None
        pending += [field.type.nested_type_name for field in fields[name] if field.type.type_id % _BLOCK == _NESTED]
    return list(visited)


def _text(fields: Sequence[Any]) -> str:
    parts = ((_type(field.type), field.name, _default(field)) for field in fields if field.name != DUMMY)
    return "\n".join(" ".join(filter(None, each)) for each in parts)


def _default(field: Any) -> str:
    """Return the default value of a field as in a definition, or an empty string. Descriptions use Python's notation.

    Strings that a definition cannot contain are omitted: there, a line break or a comment ends the string.
    """
    text = str(field.default_value)
    block, kind = divmod(field.type.type_id, _BLOCK)
    if not text or kind == _NESTED or any(each in text for each in "\n\r#="):
        return ""
    if block:
        return f"[{text[1:-1].rstrip(', ')}]"
    return '"' + text.replace('"', '\\"') + '"' if "string" in _BOUNDED.get(kind, _PRIMITIVES.get(kind, "")) else text


def _type(message: Any) -> str:
    block, kind = divmod(message.type_id, _BLOCK)
    if block >= len(_SUFFIXES):
        raise ValueError(f"unknown field type id {message.type_id}")
    if kind == _NESTED:
        element = _short(message.nested_type_name)
    elif kind in _BOUNDED:
        element = f"{_BOUNDED[kind]}<={message.string_capacity}"
    elif kind in _PRIMITIVES:
        element = _PRIMITIVES[kind]
    else:
        raise ValueError(f"a field of the type {message.type_id} has no name in a .msg")
    return element + _SUFFIXES[block].format(message.capacity)


def _short(name: str) -> str:
    return name.replace("/msg/", "/")
