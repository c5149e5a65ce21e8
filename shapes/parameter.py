"""Parameters as their nodes declare them: RDF, a SHACL shape, and the validation of values. Pure."""

from __future__ import annotations

import re
from collections.abc import Mapping

from msgspec.structs import replace
from pyoxigraph import Literal, NamedNode, Triple

from rosld.adapters.model import Descriptor, ParameterType, ParameterValue, Range, coerce
from rosld.ontology.body import Term
from rosld.ontology.parameters import parameter_literal, plain_value
from rosld.ontology.triples import boolean, double, integer, text, triples_about
from rosld.ontology.units import UNKNOWN, Quantity
from rosld.ontology.urls import Space
from rosld.ontology.violations import LoweringError, Violation, brief_value
from rosld.ontology.vocab import dcterms, rdf, rdfs, ros, sh, xsd
from rosld.shapes.accepted_values import PARAMETER_ARRAYS, PARAMETERS, parameter_array_pattern
from rosld.shapes.affordance import value_shape_triples
from rosld.shapes.compiled_shape import component
from rosld.shapes.components import list_terms, phrase
from rosld.shapes.limit_parts import Demand
from rosld.shapes.value import Bounds, OpenShape, ScalarShape
from rosld.shapes.writer import within

_MAX_CHOICES = 32
"""Maximum number of steps in a range that SHACL Core can list value by value."""

_INT64 = Range(-(2**63), 2**63 - 1)


def constraint_url(url: str, descriptor: Descriptor | None) -> str | None:
    """Return the shape of the parameter at a URL; None if its values are unconstrained."""
    return None if descriptor is None or descriptor.type is None else f"{url}#constraint"


def declared_shape(descriptor: Descriptor, quantity: Quantity = UNKNOWN) -> ScalarShape | OpenShape:
    """Return the shape of a value; open for arrays and if the type may change."""
    kind = None if descriptor.type is None else PARAMETERS.get(descriptor.type)
    if kind is None:
        return OpenShape(quantity=quantity)
    return ScalarShape(
        kind, replace(_bounds(_range(descriptor)), choices=_chosen(descriptor)), quantity, is_parameter=True
    )


def _expand_steps(descriptor: Descriptor) -> ScalarShape | OpenShape:
    """Return the shape of a value with its steps as choices if they are few."""
    declared = declared_shape(descriptor)
    choices = declared.bounds.choices or _choices(descriptor.range)
    return replace(declared, bounds=replace(declared.bounds, choices=choices))


def declared_demand(descriptor: Descriptor) -> Demand:
    """Return the demand on a scalar beyond its type, as far as SHACL Core can express steps."""
    bounds, range = replace(_expand_steps(descriptor).bounds, step=None), descriptor.range
    return Demand((("", bounds),) if bounds else (), range is None or not range.step or bool(bounds.choices))


def declared_triples(descriptor: Descriptor, url: str, space: Space) -> list[Triple]:
    """Return the triples about the declaration of the parameter at a URL: its description, type, and shape."""
    subject = NamedNode(url)
    constraint = constraint_url(url, descriptor)
    shape = None if constraint is None else NamedNode(constraint)
    type = descriptor.type
    triples = triples_about(
        subject,
        (dcterms.description, text(descriptor.description or None)),
        (ros.readOnly, boolean(descriptor.read_only)),
        (ros.parameterType, None if type is None else text(type.value)),
        (ros.shape, shape),
    )
    if shape is None or type is None:
        return triples
    value = within(shape, "value")
    triples += value_shape_triples(_expand_steps(descriptor), shape, ros.value, space)
    triples += triples_about(shape, (sh.targetNode, subject))
    return triples + triples_about(
        value,
        (sh.datatype, _ARRAYS.get(type)),
        (sh.description, text(descriptor.constraints or None)),
        *((rdfs.comment, text(words)) for words in choice_words(descriptor)),
    )


def choice_words(descriptor: Descriptor) -> tuple[str, ...]:
    """Return the labels and descriptions of choices that have any."""
    named = ((choice, choice.name not in ("", str(choice.value))) for choice in descriptor.choices)
    return tuple(
        (f"{choice.name} = {choice.value}" if is_named else f"{choice.value}")
        + (f": {choice.description}" if choice.description else "")
        for choice, is_named in named
        if is_named or choice.description
    )


def _chosen(descriptor: Descriptor) -> tuple[Literal, ...]:
    return tuple(found for choice in descriptor.choices if (found := parameter_literal(choice.value)) is not None)


_ARRAYS: Mapping[ParameterType, NamedNode] = {
    type: xsd.base64Binary if type is ParameterType.BYTE_ARRAY else rdf.JSON
    for type in ParameterType
    if type not in PARAMETERS
}


def _range(descriptor: Descriptor) -> Range | None:
    """Return the range of a number; integers of ROS 2 have 64 bits."""
    return _INT64 if descriptor.range is None and descriptor.type is ParameterType.INTEGER else descriptor.range


def _bounds(range: Range | None) -> Bounds:
    if range is None:
        return Bounds()
    return Bounds(minimum=_number(range.minimum), maximum=_number(range.maximum), step=_number(range.step))


def _number(value: int | float | None) -> Literal | None:
    return double(value) if isinstance(value, float) else integer(value)


def _choices(declared: Range | None) -> tuple[Literal, ...]:
    """Return all integers of a range with a step if they are few; empty if SHACL Core cannot express them."""
    match declared:
        case Range(int(least), int(greatest), int(step)) if step > 1 and (greatest - least) // step < _MAX_CHOICES:
            values = dict.fromkeys((*range(least, greatest + 1, step), greatest))
            return tuple(found for value in values if (found := integer(value)) is not None)
    return ()


def violations(descriptor: Descriptor, name: str, url: str, value: ParameterValue) -> tuple[Violation, ...]:
    """Return the violations of the declaration of the parameter `name` at `url`: of its type, range or step.

    Other forms that the type permits (1 for 1.0) fit.
    """
    type = descriptor.type
    fit = value if type is None else coerce(value, type)
    term = None if isinstance(value, dict) else parameter_literal(value)
    written = brief_value(plain_value(value) if term is None else phrase(term)) or ""
    broken: tuple[NamedNode, str] | None = None
    if fit is None:
        broken = component(sh.datatype), f"is declared as {type.value if type else 'any'}, which {written} is not"
    elif descriptor.choices and fit not in [choice.value for choice in descriptor.choices]:
        broken = component(sh.in_), f"must be one of {list_terms(_chosen(descriptor))}, not {written}"
    else:
        broken = _outside_range(descriptor, fit, written)
    if broken is None:
        return ()
    found, words = broken
    return (
        Violation(
            name,
            words,
            written,
            component=found,
            shape=NamedNode(f"{url}#constraint.value"),
            focus=NamedNode(url),
            predicate=ros.value,
            term=term,
        ),
    )


def require_form(descriptor: Descriptor | None, term: Term) -> None:
    """Raise LoweringError if RDF states a valid value in a form that the shape of the parameter cannot accept.

    This is a float where an integer is declared, since no shape could distinguish which of those are integers, and an
    element of an array in a form that is no value of its type.
    """
    type = None if descriptor is None else descriptor.type
    if type is None or not isinstance(term, Literal):
        return
    words = None
    if type is ParameterType.INTEGER and term.datatype in (xsd.double, xsd.float):
        words = "is declared as integer: write an integer, or a decimal"
    elif type is ParameterType.BYTE_ARRAY and term.datatype != xsd.base64Binary:
        words = "is declared as octets: write an xsd:base64Binary"
    elif type in PARAMETER_ARRAYS:
        pattern = parameter_array_pattern(PARAMETER_ARRAYS[type])
        if term.datatype != rdf.JSON or not re.fullmatch(pattern, term.value):
            words = f"is declared as {type.value}: write an rdf:JSON array of such values"
    if words is not None:
        raise LoweringError(Violation("", words, brief_value(phrase(term))))


def _outside_range(descriptor: Descriptor, value: ParameterValue, written: str) -> tuple[NamedNode, str] | None:
    """Return the violation of the declared range (or that of all integers) by a number or an element."""
    for each in value if isinstance(value, list) and descriptor.type is not None else [value]:
        if isinstance(each, bool) or not isinstance(each, int | float):
            continue
        range = _INT64 if isinstance(each, int) and descriptor.range is None else descriptor.range
        if range is None:
            continue
        if not each >= range.minimum:
            return component(sh.minInclusive), f"must be at least {_number_text(range.minimum)}, not {written}"
        if not each <= range.maximum:
            return component(sh.maxInclusive), f"must be at most {_number_text(range.maximum)}, not {written}"
        if not range.is_on_step(each):
            least, step, most = map(_number_text, (range.minimum, range.step, range.maximum))
            steps = f"{least} and steps of {step} from there, up to {most}"
            return ros.StepConstraintComponent, f"must be on a step ({steps}), which {written} is not"
    return None


def _number_text(value: int | float | None) -> str:
    found = _number(value)
    return "" if found is None else found.value
