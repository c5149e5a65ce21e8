"""A ROS message as a table: one row per field, nested messages as nested tables, long arrays shortened."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from itertools import islice
from typing import Any, SupportsFloat, SupportsIndex, SupportsInt, cast
from urllib.parse import quote

import numpy as np
import numpy.typing as npt
from msgspec import Struct, field
from msgspec.structs import replace

from rosld.adapters.model import STRINGS, Array, Field, Message, MessageSchema, MessageType, Nested, Primitive
from rosld.ontology.coercion import is_octets
from rosld.ontology.describe_types import definition_text
from rosld.ontology.units import Quantity, quantity_within
from rosld.server.html.view import (
    ArrayView,
    BytesView,
    TableListView,
    TableRow,
    TableView,
    TextView,
    View,
    duration_view,
    escape_controls,
    number_view,
    shorten_number,
    text_view,
    time_view,
)

TIME = "builtin_interfaces/msg/Time"
DURATION = "builtin_interfaces/msg/Duration"
DIAGNOSTIC_STATUS = "diagnostic_msgs/msg/DiagnosticStatus"

_LEVELS = {0: ("OK", "good"), 1: ("WARN", "warning"), 2: ("ERROR", "error"), 3: ("STALE", "warning")}
"""The label and the tone of each diagnostic level; labels are those of constants in DiagnosticStatus."""

_INTEGERS = frozenset(
    {"byte", "char", "octet", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}
)

_HEAD = 8
_SHORT = 4
_SHOWN = 2_000
_ITEMS = 25
_ROWS = 1_500
_DEEPEST = 40


class _Drawing(Struct):
    """State of drawing one message. `left` is the remaining number of rows: a robot may send any number."""

    types: Mapping[str, MessageType]
    simulated: bool
    octets: str | None
    plots: str | None
    has_heads: bool
    left: int = field(default=_ROWS)


def message_view(
    schema: MessageSchema,
    message: Message,
    *,
    fields: tuple[Field, ...] | None = None,
    simulated_time: bool = False,
    octets: str | None = None,
    plots: str | None = None,
    has_heads: bool = True,
) -> TableView:
    """Return the table of a message, or of some of its `fields`.

    `octets` and `plots` are the prefixes of references to a field's bytes and to a number's plot, to which the field's
    path is added; None if there are none. `has_heads`: whether to show the first bytes of byte arrays, which are
    useless next to their picture.
    """
    drawing = _Drawing(schema.types, simulated_time, octets, plots, has_heads)
    kind = schema.type if fields is None else dataclasses.replace(schema.type, fields=fields)
    return _rows(kind, message, "", 0, drawing)


def _rows(
    kind: MessageType, message: Message, path: str, depth: int, drawing: _Drawing, enclosing: Quantity | None = None
) -> TableView:
    if depth > _DEEPEST:
        return TableView((TableRow("…", (TextView("nested too deeply to show here", tone="quiet"),)),), kind.name)
    rows: list[TableRow] = []
    for each in kind.fields:
        if drawing.left <= 0:
            rows.append(
                TableRow("…", (TextView("too much to show here; the other formats are complete", tone="quiet"),))
            )
            break
        drawing.left -= 1
        content = getattr(message, each.attribute)
        if kind.name == DIAGNOSTIC_STATUS and each.name == "level":
            value = level_view(int(content))
        else:
            quantity = quantity_within(enclosing, kind.name, each)
            value = _value(each, content, f"{path}{each.name}", depth, drawing, quantity)
            if quantity is not None and isinstance(value, TextView | ArrayView):
                value = replace(value, unit=escape_controls(quantity.symbol))
            if isinstance(value, TextView) and (word := constant_name(kind, each, content)):
                value = replace(value, hint=word)
        rows.append(TableRow(each.name, (value,), hint=definition_text(each.type)))
    return TableView(tuple(rows), kind.name, short=depth > 0 and _is_short(kind))


def constant_name(kind: MessageType, field: Field, value: object) -> str:
    """Return the name of the constant for the value of an integer field; empty if there is none or several.

    A constant belongs to the field whose name is its prefix (`POWER_SUPPLY_STATUS_FULL`). Without such prefixes, two or
    more constants belong to the only field of their type (`PENDING` in `actionlib_msgs/GoalStatus`).
    """
    if not isinstance(field.type, Primitive) or field.type.name not in _INTEGERS:
        return ""
    numbers = [each for each in kind.constants if each.type in _INTEGERS]
    prefix = f"{field.name.upper()}_"
    own = [each for each in numbers if each.name.startswith(prefix)]
    if not own and sum(each.type == field.type for each in kind.fields) == 1:
        prefixes = tuple(f"{each.name.upper()}_" for each in kind.fields)
        own = [each for each in numbers if each.type == field.type.name and not each.name.startswith(prefixes)]
        own = own if len(own) > 1 else []
    found = {each.name.removeprefix(prefix) for each in own if each.value == value}
    return found.pop() if len(found) == 1 else ""


def _is_short(kind: MessageType) -> bool:
    """Whether a nested message fits on one line, such as a vector, a quaternion or a colour."""
    return len(kind.fields) <= _SHORT and all(
        isinstance(each.type, Primitive) and each.type.name not in STRINGS for each in kind.fields
    )


def _value(each: Field, value: object, path: str, depth: int, drawing: _Drawing, quantity: Quantity | None) -> View:
    if isinstance(each.type, Primitive):
        return _with_plot_link(scalar_view(each.type, value), each.type, path, drawing)
    if isinstance(each.type, Nested):
        return _nested_view(each.type, cast(Message, value), f"{path}.", depth, drawing, quantity)
    return _array(each.type, value, path, depth, drawing, quantity)


def _with_plot_link(view: View, kind: Primitive, path: str, drawing: _Drawing) -> View:
    """Return the view; a number has a link to its plot."""
    if drawing.plots is None or kind.name in STRINGS or not isinstance(view, TextView):
        return view
    return replace(view, plot=f"{drawing.plots}{quote(path, safe='')}")


def level_view(level: int) -> View:
    """Return a diagnostic level as its label and number; an unknown one as its number."""
    if level not in _LEVELS:
        return TextView(str(level), tone="number")
    word, tone = _LEVELS[level]
    return TextView(word, str(level), tone=tone)


def _nested_view(
    kind: Nested, message: Message, path: str, depth: int, drawing: _Drawing, quantity: Quantity | None
) -> View:
    if kind.name in (TIME, DURATION):
        return _time(kind.name, message, drawing)
    return _rows(drawing.types[kind.name], message, path, depth + 1, drawing, quantity)


def _time(name: str, message: Message, drawing: _Drawing) -> View:
    seconds, nanoseconds = int(getattr(message, "sec", 0)), int(getattr(message, "nanosec", 0))
    raw = f"{seconds}.{nanoseconds:09d}"
    if name == DURATION:
        return duration_view(seconds, nanoseconds)
    if drawing.simulated or (seconds == 0 and nanoseconds == 0):
        return TextView(f"{raw} s")
    return time_view(seconds * 1_000_000_000 + nanoseconds, raw)


def _array(kind: Array, value: object, path: str, depth: int, drawing: _Drawing, quantity: Quantity | None) -> View:
    if is_octets(kind):
        return _octets(np.asarray(value), path, drawing)
    values = cast("Sequence[object]", value)
    if isinstance(kind.element, Nested):
        return _messages(kind.element, values, path, depth, drawing, quantity)
    return series_view(kind.element, values)


def _messages(
    kind: Nested, values: Sequence[object], path: str, depth: int, drawing: _Drawing, quantity: Quantity | None
) -> View:
    items: list[TableView] = []
    for index, message in enumerate(islice(values, _ITEMS)):
        if drawing.left <= 0:
            break
        view = _nested_view(kind, cast(Message, message), f"{path}.{index}.", depth, drawing, quantity)
        items.append(view if isinstance(view, TableView) else TableView((TableRow(str(index), (view,)),)))
    return TableListView(len(values), tuple(items), kind.name)


def _octets(values: npt.NDArray[Any], path: str, drawing: _Drawing) -> View:
    href = f"{drawing.octets}{quote(path, safe='')}" if drawing.octets is not None and len(values) else None
    head = bytes(values[:16].tobytes()).hex(" ") if drawing.has_heads else ""
    return BytesView(len(values), head, href)


def scalar_view(kind: Primitive, value: object) -> View:
    """Return a primitive value; floats have six significant digits, and all digits in `exact`."""
    if isinstance(value, str):
        return text_view(value)
    return number_view(_number(kind, value))


def _number(kind: Primitive, value: object) -> str:
    if kind.name == "bool":
        return "true" if value else "false"
    if kind.name == "float32":
        return _float(str(np.float32(cast(SupportsFloat, value))))
    if kind.name == "float64":
        return _float(repr(float(cast("SupportsFloat | SupportsIndex", value))))
    return str(int(cast("SupportsInt | SupportsIndex", value)))


def _float(text: str) -> str:
    return {"nan": "NaN", "inf": "INF", "-inf": "-INF"}.get(text, text)


def series_view(kind: Primitive, values: Sequence[object]) -> ArrayView:
    """Return an array of scalars: the first few and, on request, up to 2,000 more."""
    if len(values) <= _HEAD:
        return ArrayView(len(values), _join(kind, values))
    head = _join(kind, values[:_HEAD], shorten_number)
    full = _join(kind, values[:_SHOWN])
    return ArrayView(len(values), head, full + (" …" if len(values) > _SHOWN else ""))


def _join(kind: Primitive, values: Sequence[object], write: Callable[[str], str] = str) -> str:
    if kind.name in STRINGS:
        return ", ".join(f"“{element_text(value)}”" for value in values)
    return ", ".join(write(_number(kind, value)) for value in values)


def element_text(value: object) -> str:
    """Return one string of an array on one line, shortened if necessary."""
    view = text_view(str(value).replace("\n", "⏎"))
    return view.text if isinstance(view, TextView) else ""
