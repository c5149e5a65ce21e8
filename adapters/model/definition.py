"""Definitions: texts of messages, services and actions, split, named and hashed like genmsg does.

They are received from recordings and other nodes, so they have limits: in a definition of 2 kB, each type can nest the
next one twice, with more fields than fit in memory; a message of 4 bytes can have 4e9 elements without fields.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping
from typing import Literal, TypeAlias

from rosld.adapters.model.schema import PRIMITIVES, Array, FieldType, MessageType, Nested

MAX_CHARACTERS = 1024 * 1024
"""Maximum characters of a definition with its dependencies and comments."""
MAX_DECLARED = 128 * 1024
"""Maximum characters of its fields and constants: parsing them takes 2 s."""
MAX_FIELDS = 20_000
"""Maximum number of fields of a message, including those of nested messages at each occurrence."""
MAX_FIXED = 16 * 1024 * 1024
"""Maximum number of values in a message's arrays of fixed length; a nested message counts as a hundred."""
_NESTED_WEIGHT = 100


def require_short(name: str, definition: str) -> None:
    """Raise ValueError if the text of a definition, with its dependencies, takes too long to parse."""
    if len(definition) > MAX_CHARACTERS:
        raise ValueError(f"the definition of {name} has more than {MAX_CHARACTERS} characters")
    declared = sum(len(line.partition("#")[0].strip()) + 1 for line in definition.split("\n") if line.strip())
    if declared > MAX_DECLARED:
        raise ValueError(f"the fields and constants of {name} take more than {MAX_DECLARED} characters")


def require_bounded(name: str, types: Mapping[str, MessageType]) -> None:
    """Raise ValueError if a message type has too many fields, RecursionError if it contains itself."""
    fields, fixed = _Extent(types).of(name)
    if fields > MAX_FIELDS:
        raise ValueError(f"{name} has more than {MAX_FIELDS} fields, including those of nested messages")
    if fixed > MAX_FIXED:
        raise ValueError(f"the fixed-length arrays of {name} have more than {MAX_FIXED} values in total")


def may_be_empty(types: Mapping[str, MessageType]) -> bool:
    """Whether an array of these types may have elements that take no bytes in ROS 1."""
    elements = {field.type.element for kind in types.values() for field in kind.fields if isinstance(field.type, Array)}
    return any(isinstance(each, Nested) and _takes_nothing(each, types) for each in elements)


def _takes_nothing(kind: FieldType, types: Mapping[str, MessageType]) -> bool:
    if isinstance(kind, Array):
        return kind.length == 0 or (kind.length is not None and _takes_nothing(kind.element, types))
    return isinstance(kind, Nested) and all(_takes_nothing(each.type, types) for each in types[kind.name].fields)


class _Extent:
    """Counts the fields and the values of fixed arrays, once per type."""

    def __init__(self, types: Mapping[str, MessageType]) -> None:
        self._types = types
        self._cache: dict[str, tuple[int, int]] = {}
        self._above: set[str] = set()

    def of(self, name: str) -> tuple[int, int]:
        if name in self._above:
            raise RecursionError(f"{name} is nested in itself")
        if name not in self._cache:
            self._above.add(name)
            counts = [self._of_field(field.type) for field in self._types[name].fields]
            self._above.remove(name)
            self._cache[name] = sum(fields for fields, _ in counts), sum(fixed for _, fixed in counts)
        return self._cache[name]

    def _of_field(self, kind: FieldType) -> tuple[int, int]:
        if isinstance(kind, Array):
            fields, size = self._of_field(kind.element)
            return fields, size if kind.length is None else max(size, 1) * kind.length
        if isinstance(kind, Nested):
            fields, fixed = self.of(kind.name)
            return fields + 1, fixed + _NESTED_WEIGHT
        return 1, 0


_SEPARATOR = re.compile(r"^=+[ \t]*\r?$", re.MULTILINE)
_SECTION = re.compile(r"\s*MSG:[ \t]*([A-Za-z0-9_]+)/(?:(msg|srv|action)/)?([A-Za-z0-9_]+)[ \t]*\r?(?:\n|$)")
_SERVICE = re.compile(r"^---[ \t]*\r?$", re.MULTILINE)
_ALIASES = {
    "time": "builtin_interfaces/msg/Time",
    "duration": "builtin_interfaces/msg/Duration",
    "Header": "std_msgs/msg/Header",
    "roslib/Header": "std_msgs/msg/Header",
}
_PARTED = ("srv", "action")
"""Kinds of types that consist of several messages, which only derived types of ROS 2 nest."""
_MAX_DEPTH = 64


def split_sections(name: str, definition: str) -> dict[str, str]:
    """Return the texts in a concatenated definition: the type itself first, then those after `===` and `MSG:` lines.

    `roslib/Header` is read as `std_msgs/Header`, its new name. Raises ValueError for a section without a `MSG:` line.
    """
    first, *rest = _SEPARATOR.split(definition)
    texts = {name: first.strip("\n")}
    for part in rest:
        match = _SECTION.match(part)
        if not match:
            raise ValueError(f"the definition of {name} has a section without a 'MSG: package/Name' line")
        package, kind, short = match.groups()
        nested = _ALIASES.get(f"{package}/{short}", f"{package}/{kind or 'msg'}/{short}")
        texts.setdefault(nested, part[match.end() :].strip("\n"))
    return texts


def split_service(definition: str) -> tuple[str, str]:
    """Return request and response of a service definition. Raises ValueError unless it has exactly one `---` line."""
    parts = _SERVICE.split(definition)
    if len(parts) != 2:
        raise ValueError(f"a service definition has one '---' line, this one has {len(parts) - 1}")
    return parts[0].strip("\n"), parts[1].strip("\n")


def split_action(definition: str) -> tuple[str, str, str]:
    """Return goal, result and feedback of an action definition. Raises ValueError unless it has two `---` lines."""
    parts = _SERVICE.split(definition)
    if len(parts) != 3:
        raise ValueError(f"an action definition has two '---' lines, this one has {len(parts) - 1}")
    goal, result, feedback = (part.strip("\n") for part in parts)
    return goal, result, feedback


def resolve(reference: str, package: str) -> str | None:
    """Return the full name of a field's base type as written in `package`, or None for a primitive."""
    base = reference.partition("[")[0].partition("<=")[0]
    if base in PRIMITIVES:
        return None
    if base in _ALIASES:
        return _ALIASES[base]
    *packages, short = base.split("/")
    kind = packages[1] if len(packages) == 2 and packages[1] in _PARTED else "msg"
    return f"{packages[0] if packages else package}/{kind}/{short}"


def references(name: str, text: str) -> frozenset[str]:
    """Return the full names of the message types in a text."""
    package = name.partition("/")[0]
    resolved = (resolve(words[0], package) for words in map(str.split, _lines(text)) if words)
    return frozenset(found for found in resolved if found is not None)


def _lines(text: str) -> list[str]:
    return [line for line in (raw.partition("#")[0].strip() for raw in text.splitlines()) if line]


def _declarations(text: str) -> tuple[list[str], list[tuple[str, str]]]:
    """Return the constants as genmsg hashes them, and the fields as (type, name)."""
    constants: list[str] = []
    fields: list[tuple[str, str]] = []
    for raw in text.splitlines():
        clean = raw.partition("#")[0].strip()
        if not clean:
            continue
        words = clean.split()
        if words[0].partition("<=")[0] in ("string", "wstring") and "=" in clean.partition(words[0])[2]:
            head, _, value = raw.strip().partition("=")  # a string constant extends to the end of its line, with '#'
            constants.append(f"{words[0]} {head.split()[1]}={value.strip()}")
        elif "=" in clean and words[0] in PRIMITIVES:
            head, _, value = clean.partition("=")
            constants.append(f"{words[0]} {head.split()[1]}={value.strip()}")
        else:
            fields.append((words[0], words[1]))
    return constants, fields


def md5_text(name: str, text: str, md5_of: Callable[[str], str]) -> str:
    """Return the text that genmsg hashes: constants, then fields with nested types as MD5 hashes."""
    constants, fields = _declarations(text)
    package = name.partition("/")[0]
    lines = list(constants)
    for written, field in fields:
        base = written.partition("[")[0]
        nested = resolve(written, package)
        hashed = written if nested is None or base in ("time", "duration") else md5_of(nested)
        lines.append(f"{hashed} {field}")
    return "\n".join(lines).strip()


def md5(name: str, texts: Mapping[str, str]) -> str:
    """Return the hexadecimal MD5 of a message type, like genmsg. Raises KeyError naming a type missing in `texts`."""
    return _Hasher(texts).md5(name)


def message_text(name: str, texts: Mapping[str, str]) -> str:
    """Return the text whose hash is the MD5 of a type. Raises ValueError if a type contains itself."""
    return _Hasher(texts).text(name)


class _Hasher:
    """Computes hashes, once per type."""

    def __init__(self, texts: Mapping[str, str]) -> None:
        self._texts = texts
        self._cache: dict[str, str] = {}
        self._depth = 0

    def md5(self, name: str) -> str:
        if name not in self._cache:
            text = self.text(name)
            self._cache[name] = hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()
        return self._cache[name]

    def text(self, name: str) -> str:
        self._depth += 1
        if self._depth > _MAX_DEPTH:
            raise ValueError(f"{name} is nested more than {_MAX_DEPTH} deep")
        text = md5_text(name, self._texts[name], self.md5)
        self._depth -= 1
        return text


def service_md5(name: str, texts: Mapping[str, str]) -> str:
    """Return the MD5 of a service type: that of the concatenated texts of its two messages."""
    joined = message_text(f"{name}_Request", texts) + message_text(f"{name}_Response", texts)
    return hashlib.md5(joined.encode(), usedforsecurity=False).hexdigest()


def action_md5(name: str, texts: Mapping[str, str]) -> str:
    """Return the MD5 of an action type: that of `XAction`, actionlib's message with goal, result and feedback.

    `texts` contains these under their names (`pkg/action/X_Goal`, ...), and all types that they and actionlib's own
    messages nest.
    """
    package, _, short = name.partition("/action/")
    whole = f"{package}/msg/{short}"
    messages = {f"{whole}{part}": texts[f"{name}_{part}"] for part in ("Goal", "Result", "Feedback")} | {
        f"{whole}ActionGoal": f"Header header\nactionlib_msgs/GoalID goal_id\n{short}Goal goal",
        f"{whole}ActionResult": f"Header header\nactionlib_msgs/GoalStatus status\n{short}Result result",
        f"{whole}ActionFeedback": f"Header header\nactionlib_msgs/GoalStatus status\n{short}Feedback feedback",
        f"{whole}Action": "\n".join(
            f"{short}Action{part} action_{part.lower()}" for part in ("Goal", "Result", "Feedback")
        ),
    }
    return md5(f"{whole}Action", {**texts, **messages})


WrittenType: TypeAlias = Literal["msg", "srv", "action"]

_UUID = "unique_identifier_msgs/UUID goal_id"
_OF_ACTIONS = {
    "_SendGoal": f"{_UUID}\n{{of}}_Goal goal\n---\nbool accepted\nbuiltin_interfaces/Time stamp",
    "_GetResult": f"{_UUID}\n---\nint8 status\n{{of}}_Result result",
    "_FeedbackMessage": f"{_UUID}\n{{of}}_Feedback feedback",
}
_OF_SERVICES = {"_Event": "service_msgs/ServiceEventInfo info\n{of}_Request[<=1] request\n{of}_Response[<=1] response"}
_SERVICES_OF_ACTIONS = ("_SendGoal", "_GetResult")
_HALVES = ("_Request", "_Response")
_THIRDS = ("_Goal", "_Result", "_Feedback")


def derived_from(name: str) -> tuple[str, str] | None:
    """Return the origin of a derived type and the derived text with full names; None for other types."""
    kind = _folder(name)
    ends: Mapping[str, str] = {}
    if kind == "srv" or (kind == "action" and name.endswith(tuple(f"{each}_Event" for each in _SERVICES_OF_ACTIONS))):
        ends = _OF_SERVICES
    elif kind == "action":
        ends = _OF_ACTIONS
    for end, text in ends.items():
        if name.endswith(end):
            of = name.removesuffix(end)
            return of, text.format(of=of)
    return None


def written_form(name: str) -> WrittenType:
    """Return the form of a type's definition; services of actions have the form of services."""
    kind = _folder(name)
    if kind == "action" and derived_from(name) is None:
        return "action"
    is_service = name.endswith(_SERVICES_OF_ACTIONS) if kind == "action" else kind == "srv" and not derived_from(name)
    return "srv" if is_service else "msg"


def enclosing_type(name: str) -> str | None:
    """Return the service or action type that a message is part of, or None."""
    kind = _folder(name)
    if kind == "action":
        ends = (*_THIRDS, *(f"{service}{half}" for service in _SERVICES_OF_ACTIONS for half in _HALVES))
        found = next((end for end in ends if name.endswith(end)), None)
        return None if found is None else name.removesuffix("_" + found.rpartition("_")[2])
    return next((name.removesuffix(end) for end in _HALVES if kind == "srv" and name.endswith(end)), None)


def _folder(name: str) -> str:
    return name.partition("/")[2].partition("/")[0]
