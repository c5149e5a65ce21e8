"""Forms of what is on offer: to set a property, to invoke an action, each drawn from what it takes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from rosld.server.html.forms import DeleteForm, Form, MessageForm, ValueForm
from rosld.server.html.labels import capitalize, split_words
from rosld.server.html.page import Offer
from rosld.server.html.values import plain_value
from rosld.server.html.view import escape_controls
from rosld.server.hypermedia.value import Reading
from rosld.server.hypermedia.views import (
    ActionAffordance,
    ActionView,
    ComplexView,
    Member,
    PropertyAffordance,
    PropertyView,
)
from rosld.shapes.value import ScalarShape

MAX_FORMS = 100
"""Properties that can be set right on the page of their complex resource; the others have pages of their own."""


def forms_of(view: Offer) -> tuple[Form, ...]:
    """The forms on the page of a view. Those that post elsewhere than to the page's own URL say so in `action`.

    On the page of a complex resource there is one for each action, and one for each property that is a single scalar.
    """
    match view:
        case PropertyView(affordance, reading):
            return (property_form(affordance, reading),) if affordance.write else ()
        case ActionView(affordance):
            invoke = _once(action_form(affordance)) if affordance.is_open else ()
            return (*invoke, *cancel_forms(affordance))
        case ComplexView():
            actions = (form for one in view.actions for form in _once(action_form(one), one.url))
            return (*_member_forms(view), *actions)


def property_form(affordance: PropertyAffordance, reading: Reading) -> ValueForm:
    """The form for the value of a property."""
    return ValueForm(
        affordance.shape,
        value=plain_value(reading.value),
        about=escape_controls(affordance.description or ""),
        label=affordance.title or affordance.name,
    )


def _member_forms(view: ComplexView) -> Iterator[ValueForm]:
    settable = [member for member in view.members if is_scalar_member(member)]
    for member in settable[:MAX_FORMS]:
        yield replace(property_form(member.affordance, member.reading), action=member.affordance.url)


def is_scalar_member(member: Member) -> bool:
    """Whether a member can be set by one input: a scalar that is all of its property."""
    return member.affordance.write and member.field is None and isinstance(member.affordance.shape, ScalarShape)


def action_form(affordance: ActionAffordance) -> MessageForm | None:
    """The form that invokes an action, just a button where nothing is to be sent; None where it cannot be invoked."""
    if affordance.request is None:
        return None
    button = affordance.title or capitalize(split_words(affordance.name))
    return MessageForm(affordance.request, "POST", affordance.title or affordance.name, button)


def cancel_forms(affordance: ActionAffordance) -> tuple[DeleteForm, ...]:
    """The button that cancels the goals of an action, where that can be done."""
    if affordance.goals is None or not affordance.goals.can_cancel:
        return ()
    return (DeleteForm("Cancel", "Cancel the goal", "Cancels every goal that was sent from here and has not ended."),)


def _once(form: MessageForm | None, action: str = "") -> tuple[MessageForm, ...]:
    return () if form is None else (replace(form, action=action),)
