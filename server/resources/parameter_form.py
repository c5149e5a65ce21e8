"""The form that sets a parameter."""

from __future__ import annotations

from rosld.adapters.model import Descriptor
from rosld.ontology.parameters import Json
from rosld.server.html.forms import Form, ParameterForm, ValueForm
from rosld.server.html.view import escape_controls
from rosld.shapes.parameter import choice_words, declared_shape
from rosld.shapes.value import OpenShape


def parameter_form(value: Json, descriptor: Descriptor | None, note: str | None) -> Form:
    """The form for a value, drawn from what is declared of the parameter; an open one where that does not say."""
    if descriptor is None:
        return ParameterForm(value, about=note or "")
    choices = "; ".join(choice_words(descriptor))
    words = (descriptor.description, descriptor.constraints, f"{choices}." if choices else "")
    about = escape_controls(" ".join(filter(None, words)))
    shape = declared_shape(descriptor)
    if isinstance(shape, OpenShape) or isinstance(value, dict | list):
        return ParameterForm(value, about=about)
    return ValueForm(shape, value=value, title="Set the parameter", about=about)
