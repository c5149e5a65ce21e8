"""From a recorded connection to its type: what the recording defines is learnt, what it only names is looked up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_idl, get_typestore
from rosbags.typesys.base import TypesysError

from rosld.adapters.model import MessageSchema, TypeRef, UnknownType
from rosld.adapters.model.codec import store_name
from rosld.adapters.model.definition import split_action, split_service
from rosld.adapters.model.definition_limits import require_short
from rosld.adapters.model.derived import derived_from, written_form
from rosld.adapters.model.library import SEPARATOR, TypeLibrary
from rosld.adapters.recording.storage import RecordedConnection, RosVersion

_IDL_SEPARATOR = "=" * 80 + "\n"
_PART = "---"


def type_name(recorded: str) -> str:
    """The name as rosbags has it: `pkg/Name`, as ROS 1 records it, is `pkg/msg/Name`."""
    parts = recorded.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else recorded


def learn(library: TypeLibrary, connection: RecordedConnection, ros_version: RosVersion) -> tuple[TypeRef, str | None]:
    """The type of a connection, and why its messages cannot be decoded (None: they can)."""
    name = type_name(connection.type)
    named = TypeRef(name, connection.hash)
    if connection.odd is not None:
        return named, connection.odd
    try:
        if not connection.definition.strip() and ros_version == 2:
            return _message_ref(library, named), None
        # RIHS01 also hashes what a text does not hold, so that only an MD5 proves the text beside it
        proof = connection.hash if ros_version == 1 else None
        return library.learn_message(name, _text(name, connection), proof).ref, None
    except (ValueError, UnknownType) as error:
        return named, f"its type {name or '(none)'} cannot be used: {error}"


def _message_ref(library: TypeLibrary, named: TypeRef) -> TypeRef:
    schema = library.find(named)
    if not isinstance(schema, MessageSchema):
        raise ValueError("it is no message type")
    return schema.ref


def _text(name: str, connection: RecordedConnection) -> str:
    if connection.syntax == "idl":
        return _text_of_idl(name, connection.definition)
    if connection.syntax != "msg":
        raise ValueError(f"its definition is in {connection.syntax!r}")
    derived = derived_from(name)
    if derived is None or _PART not in connection.definition.splitlines():
        return connection.definition
    return _text_of_derived(*derived, connection.definition)


def _text_of_derived(of: str, text: str, definition: str) -> str:
    """A message of a hidden topic: recorders store the definition of its service or action in its stead."""
    head, separator, nested = definition.partition("\n===")
    own = [f"MSG: {name}\n{part}" for name, part in _parts(of, head).items()]
    return f"\n{SEPARATOR}\n".join([text, *own]) + "\n" + separator.lstrip("\n") + nested


def _parts(of: str, definition: str) -> Mapping[str, str]:
    """The texts of the messages that a service or an action is made of, or a service that an action is made of."""
    derived = derived_from(of)
    if derived is not None:
        action, text = derived
        return {**_parts(action, definition), **_parts_named(of, ("_Request", "_Response"), split_service(text))}
    if written_form(of) == "action":
        return _parts_named(of, ("_Goal", "_Result", "_Feedback"), split_action(definition))
    return _parts_named(of, ("_Request", "_Response"), split_service(definition))


def _parts_named(of: str, ends: Sequence[str], texts: Sequence[str]) -> Mapping[str, str]:
    return {f"{of}{end}": text for end, text in zip(ends, texts, strict=True)}


def _text_of_idl(name: str, definition: str) -> str:
    """The definition in message syntax of a type defined in OMG IDL, its dependencies appended."""
    require_short(name, definition)
    marked = definition.startswith(f"{_IDL_SEPARATOR}IDL: ")
    parts = [part.partition("\n")[2] for part in definition.split(_IDL_SEPARATOR)[1:]] if marked else [definition]
    store = get_typestore(Stores.EMPTY)
    try:
        for part in parts:
            store.register(get_types_from_idl(part))
        return store.generate_msgdef(store_name(name), ros_version=2)[0]
    except (TypesysError, SerdeError, KeyError, ValueError, AssertionError, SyntaxError) as error:
        raise ValueError(f"its IDL cannot be read: {error}") from error
