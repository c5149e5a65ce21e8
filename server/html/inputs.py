"""Inputs of forms, one per field, and their bounds. Pure values: `forms.py` creates them, the templates render them."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal, InvalidOperation
from functools import partial
from math import isfinite
from typing import ClassVar, TypeAlias

from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import Literal

from rosld.adapters.model import STRINGS, Array, Field, FieldType, MessageSchema, Nested, Primitive
from rosld.ontology.coercion import RANGES, is_octets
from rosld.ontology.describe_types import definition_text
from rosld.ontology.json_leaves import stated_default
from rosld.ontology.literals import base64_text
from rosld.ontology.neutral_message import HEADER
from rosld.ontology.units import UNKNOWN, Quantity, quantity_within
from rosld.server.html.view import escape_controls
from rosld.shapes.value import UNBOUNDED, Bounds, MessageShape, OpenShape, ScalarShape

_MAX_DIGITS = 40
_ONLY_IN_XPATH = re.compile(r"\\[A-Za-z]|\[[^\]]*\[|\(\?")
"""Constructs that XPath and browsers interpret differently: class escapes, subtraction, options."""


def parse_number(text: str) -> Decimal | None:
    """Return a text as a finite number, or None if it is not one or is too large."""
    try:
        found = Decimal(text.strip())
    except InvalidOperation:
        return None
    return found if found.is_finite() and abs(found.adjusted()) < _MAX_DIGITS else None


def same_value(one: str, other: str) -> bool:
    """Whether two texts are the same value: `1` and `1.0` are."""
    return one == other or (parse_number(one) is not None and parse_number(one) == parse_number(other))


def number_range(kind: Primitive, bounds: Bounds) -> tuple[str, str]:
    """Return the minimum and maximum of an input as texts; empty where there is none.

    Inputs have no exclusive bounds: for integers the next integer is used, for other numbers the bound itself.
    """
    least, greatest = RANGES.get(kind.name, (None, None))
    lower = _ends(least, bounds.minimum, bounds.exclusive_minimum, ROUND_CEILING, 1)
    upper = _ends(greatest, bounds.maximum, bounds.exclusive_maximum, ROUND_FLOOR, -1)
    return _text(max(lower, default=None)), _text(min(upper, default=None))


def _ends(
    own: int | None, inclusive: Literal | None, exclusive: Literal | None, rounding: str, inward: int
) -> Iterator[Decimal]:
    """Yield one end of a range by the type (`own`, of whole numbers) and by each bound."""
    if own is not None:
        yield Decimal(own)
    for bound, step in ((inclusive, 0), (exclusive, inward)):
        number = _bound(bound)
        if number is not None:
            whole = number.to_integral_value(rounding)
            yield number if own is None else whole + step if whole == number else whole


def number_step(kind: Primitive, bounds: Bounds) -> str:
    """Return the step of an input.

    Browsers count steps from the minimum. The step is omitted if it would exclude the maximum.
    """
    plain = "1" if kind.name in RANGES else "any"
    step, least, greatest = (_bound(each) for each in (bounds.step, bounds.minimum, bounds.maximum))
    if step is None:
        return plain
    even = least is not None and greatest is not None and (greatest - least) % step == 0
    return _text(step) if even else plain


def _bound(literal: Literal | None) -> Decimal | None:
    return None if literal is None else parse_number(literal.value)


def _text(value: Decimal | None) -> str:
    return "" if value is None else f"{value:f}"


def option_texts(kind: Primitive | None, bounds: Bounds) -> tuple[str, ...]:
    """Return the texts of the choices, in order; for integer types without a fraction."""
    return tuple(dict.fromkeys(_option(kind, choice) for choice in bounds.choices))


def _option(kind: Primitive | None, choice: Literal) -> str:
    found = parse_number(choice.value) if kind is not None and kind.name in RANGES else None
    return str(int(found)) if found is not None and found == found.to_integral_value() else choice.value


def browser_pattern(bounds: Bounds) -> str:
    """Return the `pattern` of an input, which browsers match against the whole text; empty if they may differ."""
    if bounds.pattern is None or _ONLY_IN_XPATH.search(bounds.pattern):
        return ""
    return f".*(?:{bounds.pattern}).*"


def describe_bounds(bounds: Bounds) -> str:
    """Return the constraints as a sentence; empty without any, or if the options show them."""
    if bounds.choices:
        return ""
    found = ", ".join(_phrases(bounds))
    return f"{found[:1].upper()}{found[1:]}." if found else ""


def _phrases(bounds: Bounds) -> Iterator[str]:
    if bounds.minimum is not None and bounds.maximum is not None:
        yield f"from {bounds.minimum.value} to {bounds.maximum.value}"
    elif bounds.minimum is not None:
        yield f"at least {bounds.minimum.value}"
    elif bounds.maximum is not None:
        yield f"at most {bounds.maximum.value}"
    if bounds.exclusive_minimum is not None:
        yield f"more than {bounds.exclusive_minimum.value}"
    if bounds.exclusive_maximum is not None:
        yield f"less than {bounds.exclusive_maximum.value}"
    if bounds.step is not None:
        yield f"in steps of {bounds.step.value}"
    if bounds.min_length is not None:
        yield f"at least {_characters(bounds.min_length)}"
    if bounds.max_length is not None:
        yield f"at most {_characters(bounds.max_length)}"
    if bounds.pattern is not None:
        yield f"must match {bounds.pattern}"


def _characters(count: int) -> str:
    return f"{count} character{'' if count == 1 else 's'}"


Json: TypeAlias = "bool | int | float | str | Sequence[Json] | Mapping[str, Json] | None"
"""Parsed plain JSON; integers have any size."""

FLOATS = frozenset({"float32", "float64"})
MAX_LEAVES = 120
"""Maximum number of fields, at all levels, of a fieldset; a larger message is one text of JSON."""
MAX_TEXT = 20_000
"""Maximum number of characters in an input; a longer value leaves it empty and must be sent by other means."""
_DEEPEST = 64
_FOLDED = frozenset({"stamp", "covariance"})
"""Fields whose defaults are nearly always right, in any message."""


class Input(Struct, frozen=True):
    """One input. `type` is number, text, checkbox, textarea or select; `name` is the path of the field.

    `value` is the text in it ("true" or "" for a checkbox), `hint` the ROS type, `unit` the symbol next to it, `note`
    an explanation below it, `error` the violation. A select without a valid value requires a choice. An input is folded
    if its default is nearly always right.
    """

    kind: ClassVar[str] = "input"
    name: str
    label: str
    type: str
    value: str = ""
    hint: str = ""
    note: str = ""
    error: str = ""
    required: bool = True
    min: str = ""
    max: str = ""
    step: str = ""
    pattern: str = ""
    minlength: str = ""
    maxlength: str = ""
    options: tuple[str, ...] = ()
    unit: str = ""
    is_folded: bool = False

    @property
    def lines(self) -> int:
        """The number of lines of a textarea."""
        return max(2, min(12, self.value.count("\n") + 1 + len(self.value) // 60))


class Fieldset(Struct, frozen=True):
    """The inputs of a nested message; folded if their defaults are nearly always right, as in a header."""

    kind: ClassVar[str] = "fieldset"
    name: str
    label: str
    hint: str
    inputs: tuple[Control, ...]
    error: str = ""
    is_folded: bool = False


Control: TypeAlias = Input | Fieldset


class InputValues(Struct, frozen=True):
    """Values of a form: those `typed` before, or else those of a value; `errors` by path."""

    submitted: Mapping[str, str] | None = None
    errors: Mapping[str, str] | None = None

    def text(self, path: str, otherwise: str) -> str:
        """Return the text in the input of `path`."""
        return otherwise if self.submitted is None else self.submitted.get(path, "")

    def error(self, path: str) -> str:
        """Return the error at `path`."""
        return escape_controls((self.errors or {}).get(path, ""))

    def error_below(self, path: str) -> str:
        """Return the error at `path` or below, for a field without nested inputs."""
        found = (
            message if name == path else f"{name}: {message}"
            for name, message in (self.errors or {}).items()
            if name == path or name.startswith((f"{path}.", f"{path}["))
        )
        return escape_controls("; ".join(found))


def controls(
    shape: MessageShape,
    fields: Iterable[Field],
    value: Json,
    filling: InputValues,
    prefix: str = "",
    name: str | None = None,
    enclosing: Quantity | None = None,
) -> tuple[Control, ...]:
    """Return the inputs for fields of a message or one in it; `value` is plain JSON, completed by defaults.

    `name` is the type of a message in it, `enclosing` what the field that holds that measures.
    """
    values = value if isinstance(value, Mapping) else {}
    type_name = name or shape.schema.ref.name
    return tuple(
        _control(
            shape,
            each,
            f"{prefix}{each.name}",
            values.get(each.name),
            filling,
            quantity_within(enclosing, type_name, each),
        )
        for each in fields
    )


def _control(
    shape: MessageShape, each: Field, path: str, value: Json, filling: InputValues, quantity: Quantity | None
) -> Control:
    schema = shape.schema
    if is_fieldset(schema, each.type):
        assert isinstance(each.type, Nested)
        inner = controls(
            shape, schema.types[each.type.name].fields, value, filling, f"{path}.", each.type.name, quantity
        )
        is_folded = each.type.name == HEADER or each.name in _FOLDED
        return Fieldset(
            path, each.name, each.type.name, inner, filling.error(path), is_folded and not filling.error_below(path)
        )
    if value is None:
        value = default(schema, each)
    if isinstance(each.type, Primitive):
        scalar = ScalarShape(each.type, shape.bounds.get(path, UNBOUNDED), quantity or UNKNOWN)
        return scalar_input(scalar, each.name, path, value, filling)
    made = _json(each.type, each.name, path, value, filling)
    return replace(made, unit=unit_text(quantity or UNKNOWN), is_folded=each.name in _FOLDED and not made.error)


def is_fieldset(schema: MessageSchema, kind: FieldType) -> bool:
    """Whether a field is a fieldset: a nested message that is not too large."""
    return isinstance(kind, Nested) and count_inputs(schema, kind.name) <= MAX_LEAVES


def count_inputs(schema: MessageSchema, name: str) -> int:
    """Return the number of inputs for all fields of a type, counted up to `MAX_LEAVES`."""
    count = 0
    waiting = [name]
    while waiting and count <= MAX_LEAVES:
        for each in schema.types[waiting.pop()].fields:
            count += 1
            if isinstance(each.type, Nested):
                waiting.append(each.type.name)
    return count


def scalar_input(shape: ScalarShape | OpenShape, label: str, path: str, value: Json, filling: InputValues) -> Input:
    """Return the input for one scalar, or a select of its choices; `value` is plain JSON."""
    kind, bounds = shape.kind, shape.bounds
    note, unit = describe_bounds(bounds), unit_text(shape.quantity)
    scalar = partial(Input, path, label, error=filling.error_below(path))
    if kind is None or bounds.choices:
        options = option_texts(kind, bounds)
        text = filling.text(path, parameter_text(value) if kind is None else _plain_text(kind, value))
        chosen = escape_controls(next((option for option in options if same_value(option, text)), text))
        hint = kind.name if kind else ""
        return scalar("select", chosen, hint=hint, options=tuple(map(escape_controls, options)), unit=unit)
    if kind.name == "bool":
        is_checked = bool(filling.text(path, "true" if value is True else ""))
        return scalar("checkbox", "true" if is_checked else "", hint="bool", required=False)
    if kind.name not in STRINGS:
        text, (least, greatest) = filling.text(path, number_text(value)), number_range(kind, bounds)
        return scalar(
            "number" if _browser_reads(text) else "text",
            escape_controls(text),
            hint=kind.name,
            note=escape_controls(note),
            min=least,
            max=greatest,
            step=number_step(kind, bounds),
            unit=unit,
        )
    present = value if isinstance(value, str) and is_editable_text(value) else None
    text = filling.text(path, present or "")
    fixed = "The current value cannot be edited here." if present is None and filling.submitted is None else ""
    longest = min((each for each in (kind.bound, bounds.max_length) if each is not None), default="")
    return scalar(
        "textarea" if "\n" in text or "\r" in text else "text",
        escape_controls(text),
        hint=definition_text(kind),
        note=escape_controls(" ".join(filter(None, (fixed, note)))),
        required=bool(bounds.min_length),
        pattern=escape_controls(browser_pattern(bounds)),
        minlength=str(bounds.min_length or ""),
        maxlength=str(longest),
    )


def unit_text(quantity: Quantity) -> str:
    """Return the symbol of a unit; empty where there is none."""
    return escape_controls(quantity.symbol)


def _plain_text(kind: Primitive, value: Json) -> str:
    if kind.name == "bool":
        return "true" if value is True else "false"
    if kind.name in STRINGS:
        return value if isinstance(value, str) else ""
    return number_text(value)


def parameter_text(value: Json) -> str:
    """Return the value of a parameter as the text of an input."""
    if value is None or (isinstance(value, str) and is_editable_text(value)):
        return value or ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return number_text(value) if isinstance(value, int | float) else editable_json(value, indent=2)


def is_editable_text(text: str) -> bool:
    """Whether a browser returns a text unchanged: it is short enough and has no control characters."""
    return len(text) <= MAX_TEXT and escape_controls(text) == text and "\r" not in text


def number_text(value: Json) -> str:
    """Return a number of plain JSON as the text of an input."""
    if isinstance(value, bool):
        return str(int(value))
    return value if isinstance(value, str) else repr(value) if isinstance(value, int | float) else "0"


def _browser_reads(text: str) -> bool:
    """Whether a number input can show a text; it would lose NaN, INF and invalid entries."""
    try:
        return text == "" or (isfinite(float(text)) and "_" not in text and text.strip("+ ") == text)
    except (ValueError, OverflowError):
        return False


def _json(kind: FieldType, label: str, path: str, value: Json, filling: InputValues) -> Input:
    present = json_text(kind, value)
    text = filling.text(path, present or "")
    too_long = "The current value is too long to edit here."
    return Input(
        path,
        label,
        "textarea",
        escape_controls(text),
        hint=definition_text(kind),
        note=too_long if present is None and filling.submitted is None else _how(kind),
        error=filling.error_below(path),
        required=not is_base64(kind),
    )


def _how(kind: FieldType) -> str:
    if is_base64(kind):
        return "base64"
    return "JSON object" if isinstance(kind, Nested) else "JSON array"


def is_base64(kind: FieldType) -> bool:
    """Whether the plain JSON of a field is one string of base64."""
    return isinstance(kind, Array) and is_octets(kind)


def json_text(kind: FieldType, value: Json) -> str | None:
    """Return the text of a field edited as JSON (or base64); None if the value is elided or too long."""
    if is_base64(kind):
        return value if isinstance(value, str) and len(value) <= MAX_TEXT else None
    if not isinstance(value, list if isinstance(kind, Array) else Mapping):
        return None
    try:
        text = editable_json(value, indent=2 if _is_of_messages(kind) else None)
    except (TypeError, ValueError):
        return None
    return text if len(text) <= MAX_TEXT else None


def editable_json(value: Json, indent: int | None = None) -> str:
    """Return a value as JSON that a browser returns unchanged."""
    text = json.dumps(value, ensure_ascii=False, indent=indent)
    return text if escape_controls(text) == text else json.dumps(value, indent=indent)


def _is_of_messages(kind: FieldType) -> bool:
    return isinstance(kind.element if isinstance(kind, Array) else kind, Nested)


def default(schema: MessageSchema, field: Field) -> Json:
    """Return the default of a field as plain JSON; None if it is too large to edit."""
    left = iter(range(MAX_TEXT // 2))  # nested arrays in a short definition can exceed memory

    def of(field: Field, depth: int) -> Json:
        stated = stated_default(field)
        return unstated(field.type, depth) if stated is None else stated

    def unstated(kind: FieldType, depth: int) -> Json:
        if next(left, None) is None or depth > _DEEPEST:
            raise OverflowError
        if isinstance(kind, Primitive):
            return "" if kind.name in STRINGS else False if kind.name == "bool" else 0
        if isinstance(kind, Nested):
            return {each.name: of(each, depth + 1) for each in schema.types[kind.name].fields}
        if is_base64(kind):
            return base64_text(bytes(min(kind.length or 0, MAX_TEXT)))
        return [unstated(kind.element, depth + 1) for _ in range(kind.length or 0)]

    try:
        return of(field, 0)
    except OverflowError:
        return None
