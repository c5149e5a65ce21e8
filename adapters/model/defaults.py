"""Default values of fields, as ROS 2's definitions state them: `float64 w 1`. Pure.

They are read as rosidl_adapter reads them. ROS 1 has none: every field of a new message is zero or empty.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from rosld.adapters.model.schema import Array, Default, Field, FieldType, Primitive, Scalar

_STATED_ELSEWHERE: Mapping[tuple[str, str], str] = {("geometry_msgs/msg/Quaternion", "w"): "1"}
"""What ROS 2's definition says and a definition of ROS 1 cannot: a quaternion of zeros is no rotation."""
_STRINGS = frozenset({"string", "wstring"})
_ELEMENT = re.compile(r""" *(?:"((?:\\.|[^"\\])*)"|'((?:\\.|[^'\\])*)'|([^,"' ][^,]*)) *(?:,|$)""")
_TRUE, _FALSE = frozenset({"true", "1"}), frozenset({"false", "0"})
_OCTET = (0, 255)
_MAX_DIGITS = 100


def default_texts(name: str, text: str) -> Mapping[str, str]:
    """The texts of the default values that the definition `text` of a message type gives its fields, by their names."""
    found = {field: value for (kind, field), value in _STATED_ELSEWHERE.items() if kind == name}
    for line in text.splitlines():
        words = line.replace("\t", " ").partition("#")[0].split(None, 2)
        if len(words) == 3 and "=" not in words[1] + words[2]:
            found[words[1]] = words[2].rstrip()
    return found


def with_default(field: Field, texts: Mapping[str, str]) -> Field:
    """The field with its default value, if it has one that fits its type: ROS builds no package with another."""
    text = texts.get(field.name)
    if text is None:
        return field
    try:
        return Field(field.name, field.type, field.attribute, read_default(field.type, text))
    except ValueError:
        return field


def read_default(kind: FieldType, text: str) -> Default:
    """The value that a definition's text is for a field of a type. Raises ValueError where it is none."""
    if isinstance(kind, Primitive):
        return _scalar(kind, _unquoted(text) if kind.name in _STRINGS else text)
    if not isinstance(kind, Array) or not isinstance(kind.element, Primitive):
        raise ValueError("a field that is a message has no default value of its own")
    if not (text.startswith("[") and text.endswith("]")):
        raise ValueError(f"{text} is no array: it stands in brackets")
    element = kind.element
    values = tuple(_scalar(element, each) for each in _elements(text[1:-1], element))
    most = kind.length if kind.length is not None else kind.bound
    if (most is not None and len(values) > most) or (kind.length is not None and len(values) < kind.length):
        raise ValueError(f"{len(values)} elements are not as many as there may be")
    return values


def _elements(text: str, element: Primitive) -> Sequence[str]:
    """The texts between the commas of an array; strings may stand in quotes, which are taken off."""
    if not text.strip():
        return ()
    if element.name not in _STRINGS:
        return [each.strip() for each in text.split(",")]
    found, place = [], 0
    while place < len(text):
        match = _ELEMENT.match(text, place)
        if match is None:
            raise ValueError(f"{text} is no list of strings")
        double, single, bare = match.groups()
        quoted = _unescaped(double, '"') if double is not None else _unescaped(single or "", "'")
        found.append(quoted if bare is None else bare.rstrip())
        place = match.end()
    return found


def _scalar(kind: Primitive, text: str) -> Scalar:
    name = kind.name
    if name in _STRINGS:
        if kind.bound is not None and len(text) > kind.bound:
            raise ValueError(f"{text!r} is longer than {kind.bound}")
        return text
    if name == "bool":
        if text.lower() not in _TRUE | _FALSE:
            raise ValueError(f"{text} is neither true nor false")
        return text.lower() in _TRUE
    return float(text) if name.startswith("float") else _integer(name, text)


def _integer(name: str, text: str) -> int:
    """Decimal, or with the prefix of another base."""
    if len(text) > _MAX_DIGITS:
        raise ValueError(f"{len(text)} characters are no {name}")
    try:
        value = int(text)
    except ValueError:
        value = int(text, 0)
    least, greatest = _range(name)
    if not least <= value <= greatest:
        raise ValueError(f"{text} is no {name}")
    return value


def _range(name: str) -> tuple[int, int]:
    if name in ("byte", "char"):
        return _OCTET
    bits = int(name.lstrip("uint"))
    return (0, 2**bits - 1) if name.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


def _unquoted(text: str) -> str:
    """A string, without the quotes that it may stand in. Raises ValueError for a quote within that is not escaped."""
    for quote in ('"', "'"):
        if len(text) > 1 and text.startswith(quote) and text.endswith(quote):
            if re.search(rf"(?<!\\){quote}", text[1:-1]):
                raise ValueError(f"{text} has a {quote} within")
            return _unescaped(text[1:-1], quote)
    return text


def _unescaped(text: str, quote: str) -> str:
    return text.replace(f"\\{quote}", quote)
