"""Definitions: the texts of messages, services and actions, split, named and hashed as genmsg does."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping

_SEPARATOR = re.compile(r"^=+[ \t]*\r?$", re.MULTILINE)
_SECTION = re.compile(r"\s*MSG:[ \t]*([A-Za-z0-9_]+)/(?:(msg|srv|action)/)?([A-Za-z0-9_]+)[ \t]*\r?(?:\n|$)")
_SERVICE = re.compile(r"^---[ \t]*\r?$", re.MULTILINE)
_PRIMITIVES = frozenset(
    [
        "bool",
        "byte",
        "char",
        "float32",
        "float64",
        "int8",
        "uint8",
        "int16",
        "uint16",
        "int32",
        "uint32",
        "int64",
        "uint64",
        "string",
        "wstring",
    ]
)
_ALIASES = {
    "time": "builtin_interfaces/msg/Time",
    "duration": "builtin_interfaces/msg/Duration",
    "Header": "std_msgs/msg/Header",
    "roslib/Header": "std_msgs/msg/Header",
}
_PARTED = ("srv", "action")
"""Kinds of types that are made of several messages, which nothing nests but what ROS 2 derives from them."""
_MAX_DEPTH = 64


def split_sections(name: str, definition: str) -> dict[str, str]:
    """The texts in a concatenated definition: the type itself first, then those after `===` and `MSG:` lines.

    The old `roslib/Header` is read as `std_msgs/Header`, of which it is the former name.
    Raises ValueError for a section without its `MSG:` line.
    """
    first, *rest = _SEPARATOR.split(definition)
    texts = {name: first.strip("\n")}
    for part in rest:
        found = _SECTION.match(part)
        if not found:
            raise ValueError(f"the definition of {name} has a section without a 'MSG: package/Name' line")
        package, kind, short = found.groups()
        nested = _ALIASES.get(f"{package}/{short}", f"{package}/{kind or 'msg'}/{short}")
        texts.setdefault(nested, part[found.end() :].strip("\n"))
    return texts


def split_service(definition: str) -> tuple[str, str]:
    """Request and response of a service definition; raises ValueError unless exactly one `---` line parts them."""
    parts = _SERVICE.split(definition)
    if len(parts) != 2:
        raise ValueError(f"a service definition has one '---' line, this one has {len(parts) - 1}")
    return parts[0].strip("\n"), parts[1].strip("\n")


def split_action(definition: str) -> tuple[str, str, str]:
    """Goal, result and feedback of an action definition; raises ValueError unless two `---` lines part them."""
    parts = _SERVICE.split(definition)
    if len(parts) != 3:
        raise ValueError(f"an action definition has two '---' lines, this one has {len(parts) - 1}")
    goal, result, feedback = (part.strip("\n") for part in parts)
    return goal, result, feedback


def resolve(reference: str, package: str) -> str | None:
    """The full name of a field's base type as written in `package`; None for a primitive."""
    base = reference.partition("[")[0].partition("<=")[0]
    if base in _PRIMITIVES:
        return None
    if base in _ALIASES:
        return _ALIASES[base]
    *packages, short = base.split("/")
    kind = packages[1] if len(packages) == 2 and packages[1] in _PARTED else "msg"
    return f"{packages[0] if packages else package}/{kind}/{short}"


def references(name: str, text: str) -> frozenset[str]:
    """The message types that a text mentions, by full name."""
    package = name.partition("/")[0]
    resolved = (resolve(words[0], package) for words in map(str.split, _lines(text)) if words)
    return frozenset(found for found in resolved if found is not None)


def _lines(text: str) -> list[str]:
    return [line for line in (raw.partition("#")[0].strip() for raw in text.splitlines()) if line]


def _declarations(text: str) -> tuple[list[str], list[tuple[str, str]]]:
    """The constants as genmsg hashes them, and the fields as (type, name)."""
    constants: list[str] = []
    fields: list[tuple[str, str]] = []
    for raw in text.splitlines():
        clean = raw.partition("#")[0].strip()
        if not clean:
            continue
        words = clean.split()
        if words[0].partition("<=")[0] in ("string", "wstring") and "=" in clean.partition(words[0])[2]:
            head, _, value = raw.strip().partition("=")  # a string constant runs to the end of its line, '#' included
            constants.append(f"{words[0]} {head.split()[1]}={value.strip()}")
        elif "=" in clean and words[0] in _PRIMITIVES:
            head, _, value = clean.partition("=")
            constants.append(f"{words[0]} {head.split()[1]}={value.strip()}")
        else:
            fields.append((words[0], words[1]))
    return constants, fields


def md5_text(name: str, text: str, md5_of: Callable[[str], str]) -> str:
    """The text that genmsg hashes: constants, then fields with each nested type as its own MD5."""
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
    """The MD5 of a message type, in hex, as genmsg computes it. `texts` must be closed; KeyError names what lacks."""
    return _Hashing(texts).md5(name)


def message_text(name: str, texts: Mapping[str, str]) -> str:
    """The text whose hash is the MD5 of a type; raises ValueError for types nested in themselves."""
    return _Hashing(texts).text(name)


class _Hashing:
    """Hashes types, each once however often it is nested."""

    def __init__(self, texts: Mapping[str, str]) -> None:
        self._texts = texts
        self._known: dict[str, str] = {}
        self._depth = 0

    def md5(self, name: str) -> str:
        if name not in self._known:
            text = self.text(name)
            self._known[name] = hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()
        return self._known[name]

    def text(self, name: str) -> str:
        self._depth += 1
        if self._depth > _MAX_DEPTH:
            raise ValueError(f"{name} is nested more than {_MAX_DEPTH} deep")
        found = md5_text(name, self._texts[name], self.md5)
        self._depth -= 1
        return found


def service_md5(name: str, texts: Mapping[str, str]) -> str:
    """The MD5 of a service type: that of the texts of its two halves, one after the other."""
    joined = message_text(f"{name}_Request", texts) + message_text(f"{name}_Response", texts)
    return hashlib.md5(joined.encode(), usedforsecurity=False).hexdigest()


def action_md5(name: str, texts: Mapping[str, str]) -> str:
    """The MD5 of an action type: that of `XAction`, the message that actionlib makes of goal, result and feedback.

    `texts` holds these under their names (`pkg/action/X_Goal`, ...) and, closed, all that they and actionlib's own
    messages nest.
    """
    package, _, short = name.partition("/action/")
    whole = f"{package}/msg/{short}"
    made = {f"{whole}{part}": texts[f"{name}_{part}"] for part in ("Goal", "Result", "Feedback")} | {
        f"{whole}ActionGoal": f"Header header\nactionlib_msgs/GoalID goal_id\n{short}Goal goal",
        f"{whole}ActionResult": f"Header header\nactionlib_msgs/GoalStatus status\n{short}Result result",
        f"{whole}ActionFeedback": f"Header header\nactionlib_msgs/GoalStatus status\n{short}Feedback feedback",
        f"{whole}Action": "\n".join(
            f"{short}Action{part} action_{part.lower()}" for part in ("Goal", "Result", "Feedback")
        ),
    }
    return md5(f"{whole}Action", {**texts, **made})
