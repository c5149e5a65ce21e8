"""Type library: schemas from definitions that were received from the robot, shipped with rosld, or found in folders.

Every schema is closed and has its own type store, so that several definitions of one name (two publishers, an old
recording) coexist, distinguished by their hashes.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, lru_cache
from itertools import chain
from pathlib import Path
from typing import Literal, TypeVar

from rosbags.typesys import Stores, get_typestore

from rosld.adapters.model.codec import RosbagsCodec, message_types, typestore_of
from rosld.adapters.model.definition import (
    action_md5,
    derived_from,
    enclosing_type,
    md5,
    references,
    require_bounded,
    require_short,
    service_md5,
    split_action,
    split_sections,
    split_service,
    written_form,
)
from rosld.adapters.model.errors import UnknownType
from rosld.adapters.model.rihs import action_hash, message_hash, service_hash
from rosld.adapters.model.schema import (
    ActionSchema,
    MessageSchema,
    MessageType,
    Schema,
    ServiceSchema,
    TypeRef,
    halves_of,
)

_S = TypeVar("_S", bound=Schema)
SEPARATOR = "=" * 80
"""Separator between the texts of a definition and its dependencies."""
SHIPPED = Path(__file__).parent / "definitions"
_BUILTIN = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/msg/Duration": "int32 sec\nuint32 nanosec",
}
_ROS1_ONLY = frozenset({"control_msgs", "dynamic_reconfigure", "move_base_msgs", "roscpp", "roslib", "tf"})
"""Shipped packages whose definitions differ or are meaningless in ROS 2."""
_ROS2_ONLY = frozenset({"action_msgs", "lifecycle_msgs", "rcl_interfaces", "type_description_interfaces"})
_MAX_FILES = 50_000
_MAX_NAME = 100
"""Maximum length of a part of a type's name that is looked up as a file name."""


class TypeLibrary:
    """Schemas by name and hash, learnt or found. Thread-safe.

    `ros_version` determines the kind of hash: 1 for genmsg's MD5, 2 for RIHS01. `folders` are searched at any depth,
    before the definitions shipped with rosld, for `PACKAGE/msg/NAME.msg`, `PACKAGE/srv/NAME.srv` and
    `PACKAGE/action/NAME.action`.
    """

    def __init__(self, *, ros_version: Literal[1, 2], folders: Sequence[Path] = ()) -> None:
        self._ros_version = ros_version
        self._folders = tuple(folders)
        self._schemas: dict[str, dict[str, Schema]] = {}
        self._nested: dict[str, dict[str, Mapping[str, str]]] = {}
        self._files: Mapping[tuple[str, str], Path] | None = None
        self._lock = threading.RLock()
        self.learn_as: Mapping[str, Callable[[str, str, str | None], Schema]] = {
            "msg": self.learn_message,
            "srv": self.learn_service,
            "action": self.learn_action,
        }

    def learn_message(self, name: str, definition: str, hash: str | None = None) -> MessageSchema:
        """Return the schema of a message type from its text. Dependencies not appended to the text are looked up.

        Raises ValueError if the text is invalid, lacks a dependency, or does not have the given `hash`.
        """
        with self._lock:
            if hash is not None and isinstance(cached := self._schemas.get(name, {}).get(hash), MessageSchema):
                return cached
            return self._keep(self._message(name, split_sections(name, definition), definition, hash))

    def learn_service(self, name: str, definition: str, hash: str | None = None) -> ServiceSchema:
        """Return the schema of a service type from its text (request, `---`, response); errors as `learn_message`."""
        with self._lock:
            return self._keep(self._service(name, definition, hash))

    def learn_action(self, name: str, definition: str, hash: str | None = None) -> ActionSchema:
        """Return the schema of an action type from its text (goal, `---`, result, `---`, feedback).

        Raises ValueError as `learn_message`. In ROS 1 its hash is that of actionlib's message `XAction`.
        """
        with self._lock:
            return self._keep(self._action(name, definition, hash))

    def find(self, ref: TypeRef) -> Schema:
        """Return the schema of a type: learnt, else from the folders, else shipped. A hash in `ref` must match.

        Raises UnknownType with the places searched.
        """
        with self._lock:
            schemas = self._schemas.get(ref.name, {})
            if ref.hash is not None and ref.hash in schemas:
                return schemas[ref.hash]
            if ref.hash is None and schemas:
                return next(reversed(schemas.values()))
            return self._look_for(ref)

    def known(self) -> Sequence[TypeRef]:
        """Return every type learnt or found so far, in this order."""
        with self._lock:
            return [schema.ref for schemas in self._schemas.values() for schema in schemas.values()]

    def _keep(self, schema: _S) -> _S:
        self._schemas.setdefault(schema.ref.name, {})[schema.ref.hash or ""] = schema
        return schema

    def _look_for(self, ref: TypeRef) -> Schema:
        if (half := self._part(ref.name)) is not None:
            return half
        reason = "its definition is neither shipped with rosld nor in the given folders; add one with --types DIR"
        written = written_form(ref.name) if self._ros_version == 2 else ref.name.partition("/")[2].partition("/")[0]
        learn = self.learn_as.get(written, self.learn_message)
        hash = ref.hash or self._nested_hash(ref.name)
        for text in chain(self._candidates(ref.name), self._nested_texts(ref.name)):
            try:
                return learn(ref.name, text, hash)
            except ValueError as error:
                reason = f"{error}; name a folder with the robot's own definition with --types DIR"
        suffix = f" with hash {ref.hash}" if ref.hash else ""
        raise UnknownType(f"the type {ref.name}{suffix} is not known: {reason}")

    def _candidates(self, name: str) -> Iterator[str]:
        """Yield texts for a name: from the user's folders, then those shipped with rosld and with rosbags."""
        if name in _BUILTIN:
            yield _BUILTIN[name]
        package, _, rest = name.partition("/")
        kind, _, short = rest.partition("/")
        if path := self._index().get((package, f"{short}.{kind}")):
            yield path.read_text("utf-8", "replace")
        stored = stored_texts(self._ros_version).get(name)
        if stored is not None and self._ros_version == 2:
            yield stored
        path = SHIPPED / package / kind / f"{short}.{kind}"
        are_plain = all(part.isidentifier() and len(part) <= _MAX_NAME for part in (package, kind, short))
        if are_plain and path.is_file() and package not in (_ROS2_ONLY if self._ros_version == 1 else _ROS1_ONLY):
            yield path.read_text("utf-8")
        if stored is not None and self._ros_version == 1:
            yield stored
        if kind == "action" and self._ros_version == 1 and (composed := self._of_messages(package, short)) is not None:
            yield composed
        if self._ros_version == 2 and (derived := derived_from(name)) is not None:
            yield derived[1]
        if self._ros_version == 2 and (part := self._part_or_none(name)) is not None:
            yield part.definition

    def _nested_texts(self, name: str) -> Iterator[str]:
        """Yield texts of a message nested in learnt types, latest first, with the dependencies."""
        for text, texts in reversed(self._nested.get(name, {}).items()):
            closed = self._closure(name, texts)
            yield "\n".join([text, *_append({each: closed[each] for each in closed if each != name})]) + "\n"

    def _nested_hash(self, name: str) -> str | None:
        """Return the hash of a message as nested in the type learnt last, or None."""
        text = next(self._nested_texts(name), None)
        return None if text is None else self._message(name, split_sections(name, text), text, None).ref.hash

    def _part(self, name: str) -> MessageSchema | None:
        """Return a message from the service or action that it is part of, or None. Raises UnknownType."""
        whole = enclosing_type(name)
        halves = () if whole is None else halves_of(self.find(TypeRef(whole)))
        return next((half for half in halves if half.ref.name == name), None)

    def _part_or_none(self, name: str) -> MessageSchema | None:
        try:
            return self._part(name)
        except UnknownType:
            return None

    def _of_messages(self, package: str, short: str) -> str | None:
        """Return the text of an action from the messages that actionlib generates, or None if these are unknown."""
        try:
            schemas = [self.find(TypeRef(f"{package}/msg/{short}{part}")) for part in ("Goal", "Result", "Feedback")]
        except UnknownType:
            return None
        texts = [split_sections(schema.ref.name, schema.definition) for schema in schemas]
        own = [texts_of.pop(schema.ref.name) for schema, texts_of in zip(schemas, texts, strict=True)]
        nested = {name: text for texts_of in texts for name, text in texts_of.items()}
        return "\n".join(["\n---\n".join(own), *_append(nested)])

    def _index(self) -> Mapping[tuple[str, str], Path]:
        if self._files is None:
            self._files = _definition_files(self._folders)
        return self._files

    def _closure(self, name: str, texts: Mapping[str, str]) -> dict[str, str]:
        """Return the texts of `name` and of all types nested in it. Raises ValueError naming a missing type."""
        closed: dict[str, str] = {}
        pending = [name]
        while pending:
            current = pending.pop()
            if current in closed:
                continue
            text = texts.get(current)
            if text is None or current in _BUILTIN:
                text = next(chain(self._candidates(current), self._nested_texts(current)), None)
            if text is None:
                raise ValueError(f"{name} needs {current}, whose definition is not known")
            own = split_sections(current, text)
            closed[current] = own[current]
            texts = {**own, **texts}
            pending.extend(references(current, own[current]) - closed.keys())
        return closed

    def _message(self, name: str, texts: Mapping[str, str], definition: str, hash: str | None) -> MessageSchema:
        require_short(name, definition)
        try:
            closed = self._closure(name, texts)
            found, types, codec = _compiled(self._ros_version, name, tuple(closed.items()))
            ref = TypeRef(name, _verify_hash(name, found, hash))
        except (KeyError, IndexError, RecursionError) as error:
            raise ValueError(f"the definition of {name} cannot be read: {error}") from error
        for each in closed:
            if each != name:
                self._nested.setdefault(each, {})[closed[each]] = closed
        return MessageSchema(ref, types, _full_text(name, closed, definition), codec)

    def _service(self, name: str, definition: str, hash: str | None) -> ServiceSchema:
        first, second = split_service(definition.partition("\n===")[0])
        texts = {f"{name}_Request": first, f"{name}_Response": second}
        shared = split_sections(name, definition)
        closed = {each: self._closure(each, {**shared, **texts}) for each in texts}
        if self._ros_version == 1:
            md5_hash = service_md5(name, {**closed[f"{name}_Request"], **closed[f"{name}_Response"]})
            hash = _verify_hash(name, md5_hash, hash)
        request, response = (self._message(each, closed[each], texts[each], None) for each in texts)
        if self._ros_version == 2:
            hash = _verify_hash(name, service_hash(name, {**request.types, **response.types}), hash)
        return ServiceSchema(TypeRef(name, hash), request, response, definition)

    def _action(self, name: str, definition: str, hash: str | None) -> ActionSchema:
        parts = split_action(definition.partition("\n===")[0])
        texts = dict(zip((f"{name}{end}" for end in _THIRDS), parts, strict=True))
        shared = split_sections(name, definition)
        closed = {each: self._closure(each, {**shared, **texts}) for each in texts}
        if self._ros_version == 1:
            actionlib = {part: text for each in _ACTIONLIB for part, text in self._closure(each, {}).items()}
            md5_hash = action_md5(
                name, {**actionlib, **{key: text for of in closed.values() for key, text in of.items()}}
            )
            hash = _verify_hash(name, md5_hash, hash)
        goal, result, feedback = (self._message(each, closed[each], texts[each], None) for each in texts)
        if self._ros_version == 2:
            hash = _verify_hash(name, action_hash(name, {**goal.types, **result.types, **feedback.types}), hash)
        return ActionSchema(TypeRef(name, hash), goal, result, feedback, definition)


_THIRDS = ("_Goal", "_Result", "_Feedback")
_ACTIONLIB = ("std_msgs/msg/Header", "actionlib_msgs/msg/GoalID", "actionlib_msgs/msg/GoalStatus")


@lru_cache(maxsize=128)
def _compiled(
    ros_version: int, name: str, texts: tuple[tuple[str, str], ...]
) -> tuple[str, Mapping[str, MessageType], RosbagsCodec]:
    """Return the hash, the types and the codec of a message type. Raises ValueError, KeyError, IndexError.

    Cached because recordings of one robot define the same types: 46 of the 54 ms of opening a small one.
    """
    closed = dict(texts)
    hash = md5(name, closed) if ros_version == 1 else None
    store = typestore_of(closed)
    types = message_types(store, closed)
    require_bounded(name, types)
    return hash or message_hash(name, types), types, RosbagsCodec(name, store, types)


def _verify_hash(name: str, hash: str, expected: str | None) -> str:
    """Return the hash of a found definition. Raises ValueError if another one is required."""
    if expected is not None and hash != expected:
        raise ValueError(f"the definition found for {name} has the hash {hash}, the robot uses {expected}")
    return hash


def _full_text(name: str, closed: Mapping[str, str], definition: str) -> str:
    """Return the concatenated definition, with missing dependencies appended in ROS 1's format."""
    sections = split_sections(name, definition)
    lacking = [each for each in closed if each not in sections and each not in _BUILTIN]
    return "\n".join([definition.rstrip("\n"), *_append({each: closed[each] for each in lacking})]) + "\n"


def _append(texts: Mapping[str, str]) -> list[str]:
    """Return the texts of types in ROS 1's format for dependencies."""
    return [f"{SEPARATOR}\nMSG: {each.replace('/msg/', '/')}\n{text}" for each, text in texts.items()]


def _definition_files(folders: Sequence[Path]) -> Mapping[tuple[str, str], Path]:
    """Return the path of each definition in these folders by package and file name; the first folder wins."""
    paths: dict[tuple[str, str], Path] = {}
    for folder in folders:
        for pattern in ("*.msg", "*.srv", "*.action"):
            for count, path in enumerate(sorted(folder.rglob(pattern))):
                if count > _MAX_FILES:
                    break
                paths.setdefault((path.parent.parent.name, path.name), path)
    return paths


@cache
def stored_texts(ros_version: Literal[1, 2]) -> Mapping[str, str]:
    """Return the texts of the types that rosbags ships, by name."""
    store = get_typestore(Stores.ROS1_NOETIC if ros_version == 1 else Stores.ROS2_JAZZY)
    texts: dict[str, str] = {}
    for name in store.fielddefs:
        text, _ = store.generate_msgdef(name, ros_version=ros_version)
        texts[name] = split_sections(name, text)[name]
    return texts
