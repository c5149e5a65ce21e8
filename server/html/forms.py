"""Forms: what a person may send to a resource, drawn from the shape of what it takes. `form_parser.py` reads them back.

A form posts as `application/x-www-form-urlencoded` to the resource at `action`, or where that is empty to its page's
own. Its first two fields are hidden: `csrf`, and `method`, the verb meant. All others are named by the path of their
field (`linear.x`), so that a message may well have a field called `method`: only the first of that name is ours.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar, TypeAlias

from rosld.adapters.model import MessageSchema
from rosld.ontology.violations import Violation
from rosld.server.html.bounds import describe_bounds
from rosld.server.html.cockpit_form import CopyForm, EditForm, Method, Pairs
from rosld.server.html.drive_pad import DrivePad
from rosld.server.html.inputs import (
    MAX_TEXT,
    Control,
    Input,
    InputValues,
    Json,
    choice_input,
    controls,
    editable_json,
    is_editable_text,
    number_text,
    scalar_input,
)
from rosld.server.html.labels import NameGroup, group_names, unit_symbol
from rosld.server.html.view import escape_controls
from rosld.shapes.value import Bounds, Measure, MessageShape, OpenShape, ScalarShape, ValueShape

METHOD_FIELD = "method"
CHOICE_FIELD = "?choice"
"""What a ticked box of a list of names sends: no field of a message begins so."""
VALUE_FIELD = "value"
TYPE_FIELD = "type"

PARAMETER_TYPES = ("number", "string", "boolean", "JSON")
"""What a parameter's form offers; whole numbers stay whole."""


@dataclass(frozen=True, slots=True)
class NameChoices:
    """Names to be ticked, which are added to what is typed into the text `field`; `urls` are what they are about."""

    field: str
    title: str
    urls: Mapping[str, str]
    ticked: frozenset[str] = frozenset()

    @property
    def names(self) -> tuple[str, ...]:
        """The names without their leading slash, which the pages show in groups."""
        return tuple(name.removeprefix("/") for name in sorted(self.urls))

    @property
    def groups(self) -> tuple[NameGroup[str], ...]:
        """The names in groups, none where they are few."""
        return group_names(self.names, lambda name: name)


@dataclass(frozen=True, slots=True)
class MessageForm:
    """A form for a message: publish it, or call a service with it.

    `value` (plain JSON, None for ROS's defaults) is what it is filled with at first, `typed` what was typed into it
    when it was sent and did not fit, `violations` why. `choices` are names that one of its texts may have; `folded` are
    the names of fields that few need.
    """

    template: ClassVar[str] = "message"
    schema: MessageSchema
    method: Method = "PUT"
    title: str = "Publish a message"
    button: str = "Publish"
    value: Json = None
    action: str = ""
    about: str = ""
    submitted: Pairs | None = None
    violations: tuple[Violation, ...] = ()
    choices: NameChoices | None = None
    folded: frozenset[str] = frozenset()

    def with_submitted(self, pairs: Pairs, violations: Iterable[Violation]) -> MessageForm:
        """The same form as it was sent, with what does not fit beside its fields."""
        ticked = frozenset(text for name, text in pairs if name == CHOICE_FIELD)
        choices = None if self.choices is None else replace(self.choices, ticked=ticked)
        return replace(self, submitted=tuple(pairs), violations=tuple(violations), choices=choices)

    def with_choices_of(self, may_read: Callable[[str], bool]) -> MessageForm:
        """The same form with no name of what its reader may not read."""
        if self.choices is None:
            return self
        urls = {name: url for name, url in self.choices.urls.items() if may_read(url)}
        return replace(self, choices=replace(self.choices, urls=urls))

    @property
    def controls(self) -> tuple[Control, ...]:
        """Its inputs: those of the message, and those of the query, with names beginning with `?`."""
        filling = _filling(self.submitted, self.violations)
        return controls(self.schema, self.schema.type.fields, self.value, filling)


@dataclass(frozen=True, slots=True)
class HoldTerms:
    """The defaults and maxima of a hold's rate (Hz) and time (s), and what is published at its end by default."""

    rate: float
    max_rate: float
    time: float
    max_time: float
    then: str


@dataclass(frozen=True, slots=True)
class HoldForm:
    """A form that holds a topic: the message, and in the query how often it is published and what becomes of that.

    `pad` is there where the topic commands a velocity. `bounds` are those of fields by their paths. The other fields
    are as those of a `MessageForm`.
    """

    template: ClassVar[str] = "hold"
    schema: MessageSchema
    terms: HoldTerms
    method: Method = "POST"
    title: str = "Hold the topic"
    button: str = "Hold"
    value: Json = None
    action: str = ""
    about: str = ""
    submitted: Pairs | None = None
    violations: tuple[Violation, ...] = ()
    bounds: Mapping[str, Bounds] = field(default_factory=dict)
    pad: DrivePad | None = None

    def with_submitted(self, pairs: Pairs, violations: Iterable[Violation]) -> HoldForm:
        """The same form as it was sent, with what does not fit beside its fields."""
        return replace(self, submitted=tuple(pairs), violations=tuple(violations))

    @property
    def controls(self) -> tuple[Control, ...]:
        """Its inputs: the message's, and those of the query, whose names begin with a question mark."""
        filling, terms = replace(_filling(self.submitted, self.violations), bounds=self.bounds), self.terms
        return (
            *controls(self.schema, self.schema.type.fields, self.value, filling),
            _query_number("?rate", "rate", terms.rate, terms.max_rate, "Hz", filling),
            _query_number("?for", "for", terms.time, terms.max_time, "s", filling),
            Input("?then", "at the end", "select", filling.text("?then", terms.then), options=("zero", "none")),
        )


def _query_number(name: str, label: str, value: float, most: float, unit: str, filling: InputValues) -> Input:
    """Return the input for a number in the query, with a maximum."""
    text = filling.text(name, f"{value:g}")
    return Input(name, label, "number", escape_controls(text), min="0.1", max=f"{most:g}", step="0.1", unit=unit)


@dataclass(frozen=True, slots=True)
class ParameterForm:
    """A form for a parameter's value: one input by the type of the present `value`, which None leaves open."""

    template: ClassVar[str] = "parameter"
    value: Json = None
    method: Method = "PUT"
    title: str = "Set the parameter"
    button: str = "Set"
    action: str = ""
    about: str = ""
    submitted: Pairs | None = None
    violations: tuple[Violation, ...] = ()

    def with_submitted(self, pairs: Pairs, violations: Iterable[Violation]) -> ParameterForm:
        """The same form as it was sent, with what does not fit beside its field."""
        return replace(self, submitted=tuple(pairs), violations=tuple(violations))

    @property
    def controls(self) -> tuple[Control, ...]:
        """Its inputs: the type, and the value."""
        return _open_controls(self.value, self.submitted, self.violations)


@dataclass(frozen=True, slots=True)
class ValueForm:
    """A form for the value of a property, drawn from its shape; `label` is what one input is called.

    `value` (plain JSON, None where there is none) is what it is filled with at first. The other fields are as those of
    a `MessageForm`.
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
    label: str = "value"

    def with_submitted(self, pairs: Pairs, violations: Iterable[Violation]) -> ValueForm:
        """The same form as it was sent, with what does not fit beside its fields."""
        return replace(self, submitted=tuple(pairs), violations=tuple(violations))

    @property
    def type(self) -> str:
        """What is sent, as ROS calls it; empty where ROS has no type for it."""
        match self.shape:
            case ScalarShape(kind):
                return kind.name
            case MessageShape(schema):
                return schema.ref.name
            case OpenShape():
                return ""

    @property
    def controls(self) -> tuple[Control, ...]:
        """Its inputs."""
        match self.shape:
            case MessageShape(schema, fields, bounds):
                filling = replace(_filling(self.submitted, self.violations), bounds=bounds)
                return controls(schema, fields, self.value, filling)
            case ScalarShape(kind, bounds, measure):
                filling = self._of_one(bounds)
                return (scalar_input(kind, self.label, VALUE_FIELD, self.value, filling, _symbol(measure)),)
            case OpenShape(bounds, measure) if bounds.choices:
                present = _parameter_text(self.value)
                filling = self._of_one(bounds)
                return (choice_input(None, self.label, VALUE_FIELD, present, bounds, filling, _symbol(measure)),)
            case OpenShape(bounds, measure):
                of_type, value = _open_controls(self.value, self.submitted, self.violations)
                note = " ".join(filter(None, (value.note, escape_controls(describe_bounds(bounds)))))
                return (of_type, replace(value, note=note, unit=_symbol(measure)))

    def _of_one(self, bounds: Bounds) -> InputValues:
        """What the one input of a scalar is filled with: nothing that does not fit can be about anything else."""
        typed = dict(self.submitted) if self.submitted is not None else None if self.value is not None else {}
        return InputValues(typed, _errors(self.violations), {VALUE_FIELD: bounds})


@dataclass(frozen=True, slots=True)
class DeleteForm:
    """A button that deletes the resource; `about` says what that does, `query` are parameters that it sends."""

    template: ClassVar[str] = "delete"
    title: str = "Delete"
    button: str = "Delete"
    about: str = ""
    action: str = ""
    method: Method = "DELETE"
    query: tuple[tuple[str, str], ...] = ()
    controls: ClassVar[tuple[Control, ...]] = ()
    violations: ClassVar[tuple[Violation, ...]] = ()


@dataclass(frozen=True, slots=True)
class ChoiceForm:
    """A button for each of several things that may be asked for by its name, which is sent as the field `name`.

    `labels` are what buttons say that do not say that name.
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


Form: TypeAlias = MessageForm | HoldForm | ParameterForm | ValueForm | DeleteForm | ChoiceForm | EditForm | CopyForm


def _filling(typed: Pairs | None, violations: Iterable[Violation]) -> InputValues:
    errors: dict[str, str] = {}
    for violation in violations:
        known = errors.get(violation.path)
        errors[violation.path] = f"{known}; {violation.with_quote}" if known else violation.with_quote
    return InputValues(None if typed is None else dict(typed), errors)


def _errors(violations: Iterable[Violation]) -> Mapping[str, str]:
    text = "; ".join(violation.with_quote for violation in violations)
    return {VALUE_FIELD: text} if text else {}


def _symbol(measure: Measure) -> str:
    return "" if measure.unit is None else escape_controls(unit_symbol(measure.unit.value))


def _open_controls(value: Json, pairs: Pairs | None, violations: Iterable[Violation]) -> tuple[Input, Input]:
    """Return the type, and the value."""
    typed = None if pairs is None else dict(pairs)
    kind = parameter_type_of(value) if typed is None else typed.get(TYPE_FIELD, "string")
    text = _parameter_text(value) if typed is None else typed.get(VALUE_FIELD, "")
    error = escape_controls("; ".join(violation.with_quote for violation in violations))
    return (
        Input(TYPE_FIELD, "type", "select", kind, options=PARAMETER_TYPES),
        replace(_parameter_input(kind, text), error=error),
    )


def parameter_type_of(value: Json) -> str:
    """Which of `PARAMETER_TYPES` a present value is typed as; a string where there is none."""
    if isinstance(value, bool):
        return "boolean"
    if isinstance(value, int | float):
        return "number"
    if value is None or isinstance(value, str):
        return "string" if is_editable_text(value or "") else "JSON"
    return "JSON"


def _parameter_text(value: Json) -> str:
    if value is None or (isinstance(value, str) and is_editable_text(value)):
        return value or ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return number_text(value)
    return editable_json(value, indent=2)


def _parameter_input(kind: str, text: str) -> Input:
    if len(text) > MAX_TEXT:
        return Input(VALUE_FIELD, "value", "textarea", note="The present value is too long to be edited here.")
    several = kind == "JSON" or "\n" in text
    return Input(VALUE_FIELD, "value", "textarea" if several else "text", escape_controls(text), required=False)
