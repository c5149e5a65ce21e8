"""Forms for requests to a resource, built from the shape of its values. `form_parser.py` parses submissions.

A form posts as `application/x-www-form-urlencoded` to the resource at `action` or, if that is empty, to the URL of its
page. Its first two fields are hidden: `csrf`, and `method`, the HTTP method. All others are named by the path of their
field (`linear.x`). A message may have a field called `method`: only the first pair of that name is the HTTP method.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping
from decimal import Decimal
from typing import ClassVar, TypeAlias

import numpy as np
from msgspec import Struct, field, to_builtins
from msgspec.structs import replace
from pyoxigraph import Literal

from rosld.adapters.model import MessageSchema, Primitive
from rosld.ontology.fields import type_at
from rosld.ontology.neutral_message import COMMANDS
from rosld.ontology.violations import Violation
from rosld.server.html.cockpit_form import CopyForm, EditForm, Method, Pairs
from rosld.server.html.inputs import (
    MAX_TEXT,
    Control,
    Input,
    InputValues,
    Json,
    controls,
    describe_bounds,
    is_editable_text,
    parameter_text,
    parse_number,
    scalar_input,
    unit_text,
)
from rosld.server.html.labels import NameGroup, group_names
from rosld.server.html.view import escape_controls
from rosld.shapes.value import UNBOUNDED, Bounds, MessageShape, OpenShape, ScalarShape, ValueShape

RATE = 20.0
"""Rate in Hz at which commands are published while the pad is pressed."""
LEASE = 0.6
"""Seconds after which the robot stops if the page or the connection is lost."""
_WITHIN = Decimal("0.999")
"""Fraction of an exclusive bound that is used as the maximum."""


class Axis(Struct, frozen=True):
    """One direction of the pad: the path of its field, its label, its unit and its range."""

    path: str
    label: str
    unit: str
    least: float
    greatest: float


class DrivePad(Struct, frozen=True):
    """A pad for a topic: forward and leftward speeds, the message for standstill, and the terms of its hold."""

    topic: str
    ahead: Axis
    left: Axis
    zero: Json
    rate: float
    lease: float
    path: str = ""
    """The path of the topic's URL; empty for the URL of the page."""

    @property
    def json(self) -> str:
        """The configuration of the script, as JSON."""
        return json.dumps(to_builtins(self))


_SPEED = Axis("linear.x", "Speed", "m/s", -1.0, 1.0)
_TURN = Axis("angular.z", "Turn", "rad/s", -2.0, 2.0)
_CAR_SPEED = Axis("speed", "Speed", "m/s", -1.0, 1.0)
_STEERING = Axis("steering_angle", "Steering", "rad", -0.6, 0.6)
_AXES: Mapping[str, tuple[str, Axis, Axis]] = {
    "geometry_msgs/msg/Twist": ("", _SPEED, _TURN),
    "geometry_msgs/msg/TwistStamped": ("twist.", _SPEED, _TURN),
    "ackermann_msgs/msg/AckermannDrive": ("", _CAR_SPEED, _STEERING),
    "ackermann_msgs/msg/AckermannDriveStamped": ("drive.", _CAR_SPEED, _STEERING),
}
"""Prefix of the field paths, and the axes with their default ranges, by message type."""
assert _AXES.keys() == COMMANDS


def drive_pad(
    topic: str, schema: MessageSchema, bounds: Mapping[str, Bounds], zero: Json, max_rate: float
) -> DrivePad | None:
    """Return the pad for a topic of a type, within the bounds of its fields; None for other types."""
    found = _AXES.get(schema.ref.name)
    if found is None:
        return None
    prefix, ahead, left = found
    first, second = (_bound_axis(axis, prefix, schema, bounds) for axis in (ahead, left))
    return DrivePad(topic, first, second, zero, min(RATE, max_rate), LEASE)


def _bound_axis(axis: Axis, prefix: str, schema: MessageSchema, bounds: Mapping[str, Bounds]) -> Axis:
    path = prefix + axis.path
    demanded, is_single = bounds.get(path, UNBOUNDED), type_at(schema, path) == Primitive("float32")
    lower = [bound for bound in (_value(demanded.minimum), _within(demanded.exclusive_minimum)) if bound is not None]
    upper = [bound for bound in (_value(demanded.maximum), _within(demanded.exclusive_maximum)) if bound is not None]
    least = max(lower, default=Decimal(str(axis.least)))
    greatest = min(upper, default=Decimal(str(axis.greatest)))
    return Axis(
        path,
        axis.label,
        axis.unit,
        _inside(least, math.inf, is_single=is_single),
        _inside(greatest, -math.inf, is_single=is_single),
    )


def _value(bound: Literal | None) -> Decimal | None:
    return None if bound is None else parse_number(bound.value)


def _within(bound: Literal | None) -> Decimal | None:
    found = _value(bound)
    return None if found is None else found * _WITHIN


def _inside(bound: Decimal, inward: float, *, is_single: bool) -> float:
    """Return the number of the field's type nearest to a bound and within it (`0.1` has no exact representation)."""
    kind = np.float32 if is_single else np.float64
    nearest = kind(bound)
    is_outside = Decimal(float(nearest)) < bound if inward > 0 else Decimal(float(nearest)) > bound
    return float(np.nextafter(nearest, kind(inward)) if is_outside else nearest)


METHOD_FIELD = "method"
CHOICE_FIELD = "?choice"
"""Name of the pair for each ticked name; no field name begins so."""
VALUE_FIELD = "value"
TYPE_FIELD = "type"

PARAMETER_TYPES = ("number", "string", "boolean", "JSON")
"""Types that the form of a parameter offers; integers stay integers."""


class NameChoices(Struct, frozen=True):
    """Names that the user can tick to add them to the text `field`; `urls` are their resources."""

    field: str
    title: str
    urls: Mapping[str, str]

    @property
    def names(self) -> tuple[str, ...]:
        """The names without a leading slash, for grouping."""
        return tuple(name.removeprefix("/") for name in sorted(self.urls))

    @property
    def groups(self) -> tuple[NameGroup[str], ...]:
        """The names in groups; empty if they are few."""
        return group_names(self.names, lambda name: name)


class ValueForm(Struct, frozen=True):
    """A form for a value of a shape: a message to publish, a request of a service, a property or a parameter.

    `value` (plain JSON, None for the defaults of ROS) fills it initially. After an invalid submission, `submitted` has
    the texts and `violations` the reasons. `label` is the label of a scalar input. `choices` are possible names for one
    of the texts; `folded` are the names of rarely needed fields.
    """

    template: ClassVar[str] = "value"
    shape: ValueShape
    method: Method = "PUT"
    title: str = "Set the value"
    button: str = "Set"
    value: Json = None
    action: str = ""
    about: str = ""
    submitted: Pairs | None = None
    violations: tuple[Violation, ...] = ()
    label: str = ""
    choices: NameChoices | None = None
    folded: frozenset[str] = frozenset()

    def with_choices_of(self, may_read: Callable[[str], bool]) -> ValueForm:
        """Return the form with only the names that its reader may read."""
        if self.choices is None:
            return self
        urls = {name: url for name, url in self.choices.urls.items() if may_read(url)}
        return replace(self, choices=replace(self.choices, urls=urls))

    @property
    def ticked(self) -> frozenset[str]:
        """The names that were ticked."""
        return frozenset(text for name, text in self.submitted or () if name == CHOICE_FIELD)

    @property
    def type(self) -> str:
        """The ROS type of the value; empty where ROS has none."""
        match self.shape:
            case ScalarShape(kind):
                return kind.name
            case MessageShape(schema):
                return schema.ref.name
            case OpenShape():
                return ""

    @property
    def controls(self) -> tuple[Control, ...]:
        """The inputs of the form."""
        shape, filling = self.shape, self._filling()
        if isinstance(shape, MessageShape):
            return controls(shape, shape.fields, self.value, filling)
        if isinstance(shape, ScalarShape) or shape.bounds.choices:
            return (scalar_input(shape, self.label or "value", VALUE_FIELD, self.value, filling),)
        return _open_controls(shape, self.value, filling)

    def _filling(self) -> InputValues:
        """Return the values of the inputs; every violation of a single input belongs to that input."""
        typed, shape = None if self.submitted is None else dict(self.submitted), self.shape
        if isinstance(shape, MessageShape):
            return InputValues(typed, _errors((each.path, each) for each in self.violations))
        if typed is None and self.value is None and (isinstance(shape, ScalarShape) or shape.bounds.choices):
            typed = {}
        return InputValues(typed, _errors((VALUE_FIELD, each) for each in self.violations))


def message_form(
    schema: MessageSchema,
    method: Method = "PUT",
    title: str = "Publish a message",
    button: str = "Publish",
    *,
    value: Json = None,
    about: str = "",
    bounds: Mapping[str, Bounds] | None = None,
) -> ValueForm:
    """Return the form that publishes a message or calls a service with it."""
    return ValueForm(MessageShape(schema, schema.type.fields, bounds or {}), method, title, button, value, about=about)


class HoldTerms(Struct, frozen=True):
    """Defaults and maxima of a hold's rate (Hz) and duration (s), and its default final message."""

    rate: float
    max_rate: float
    time: float
    max_time: float
    then: str


class HoldForm(ValueForm, frozen=True, kw_only=True):
    """A form that holds a topic: the message and, in the query, the terms of the hold.

    A topic that takes velocity commands has a `pad`.
    """

    template: ClassVar[str] = "hold"
    terms: HoldTerms
    pad: DrivePad | None = None

    @property
    def controls(self) -> tuple[Control, ...]:
        """The inputs for the message and for the query; the names of the latter begin with a question mark."""
        filling, terms = self._filling(), self.terms
        return (
            *super().controls,
            _query_number("?rate", "rate", terms.rate, terms.max_rate, "Hz", filling),
            _query_number("?for", "for", terms.time, terms.max_time, "s", filling),
            Input("?then", "at the end", "select", filling.text("?then", terms.then), options=("zero", "none")),
        )


def _query_number(name: str, label: str, value: float, most: float, unit: str, filling: InputValues) -> Input:
    """Return the input for a number in the query, with a maximum."""
    text = filling.text(name, f"{value:g}")
    return Input(name, label, "number", escape_controls(text), min="0.1", max=f"{most:g}", step="0.1", unit=unit)


class DeleteForm(Struct, frozen=True):
    """A button that deletes the resource; `about` explains the effect, `query` has the parameters to send."""

    template: ClassVar[str] = "delete"
    title: str = "Delete"
    button: str = "Delete"
    about: str = ""
    action: str = ""
    method: Method = "DELETE"
    query: tuple[tuple[str, str], ...] = ()
    controls: ClassVar[tuple[Control, ...]] = ()
    violations: ClassVar[tuple[Violation, ...]] = ()


class ChoiceForm(Struct, frozen=True):
    """A button for each of several named choices; the name is sent as the field `name`.

    `labels` are the labels of buttons that differ from the name.
    """

    template: ClassVar[str] = "choice"
    name: str
    choices: tuple[str, ...]
    title: str
    method: Method = "POST"
    about: str = ""
    action: str = ""
    labels: Mapping[str, str] = field(default_factory=dict)
    controls: ClassVar[tuple[Control, ...]] = ()
    violations: ClassVar[tuple[Violation, ...]] = ()


Form: TypeAlias = ValueForm | DeleteForm | ChoiceForm | EditForm | CopyForm


def _errors(violations: Iterable[tuple[str, Violation]]) -> Mapping[str, str]:
    errors: dict[str, str] = {}
    for path, violation in violations:
        known = errors.get(path)
        errors[path] = f"{known}; {violation.with_quote}" if known else violation.with_quote
    return errors


def _open_controls(shape: OpenShape, value: Json, filling: InputValues) -> tuple[Input, Input]:
    """Return the inputs for the type and the value."""
    typed = filling.submitted
    kind = parameter_type_of(value) if typed is None else typed.get(TYPE_FIELD, "string")
    text = filling.text(VALUE_FIELD, parameter_text(value))
    is_too_long = len(text) > MAX_TEXT
    note = "The current value is too long to edit here." if is_too_long else ""
    return (
        Input(TYPE_FIELD, "type", "select", kind, options=PARAMETER_TYPES),
        Input(
            VALUE_FIELD,
            "value",
            "textarea" if kind == "JSON" or "\n" in text or is_too_long else "text",
            "" if is_too_long else escape_controls(text),
            note=escape_controls(" ".join(filter(None, (note, describe_bounds(shape.bounds))))),
            error=filling.error(VALUE_FIELD),
            required=is_too_long,
            unit=unit_text(shape.quantity),
        ),
    )


def parameter_type_of(value: Json) -> str:
    """Return the member of `PARAMETER_TYPES` for the type of a present value; a string if there is none."""
    if isinstance(value, bool):
        return "boolean"
    if isinstance(value, int | float):
        return "number"
    if value is None or isinstance(value, str):
        return "string" if is_editable_text(value or "") else "JSON"
    return "JSON"
