"""Views as they may be seen: what is on offer to one who may not do everything. Pure."""

from __future__ import annotations

from dataclasses import replace
from typing import overload

from rosld.server.auth.permissions import Judge
from rosld.server.hypermedia.views import (
    ActionAffordance,
    ActionView,
    ComplexView,
    PropertyAffordance,
    PropertyView,
    View,
)


@overload
def veiled_view(view: ComplexView, judge: Judge) -> ComplexView: ...
@overload
def veiled_view(view: View, judge: Judge) -> View: ...
def veiled_view(view: View, judge: Judge) -> View:
    """A view without what may not be read, and with what may be done as far as the agent may do it."""
    match view:
        case ComplexView():
            return replace(
                view,
                members=tuple(
                    replace(member, affordance=veiled_property(member.affordance, judge))
                    for member in view.members
                    if judge.may_read(member.affordance.url)
                ),
                actions=tuple(action for action in view.actions if judge.may("POST", action.url)),
                links=tuple(link for link in view.links if judge.may_read(link.target)),
                children=tuple(filter(judge.may_read, view.children)),
                parent=_readable(view.parent, judge),
                mapping=_readable(view.mapping, judge),
            )
        case PropertyView():
            return replace(
                view,
                affordance=veiled_property(view.affordance, judge),
                reads_from=tuple(filter(judge.may_read, view.reads_from)),
                writes_to=tuple(filter(judge.may_read, view.writes_to)),
            )
        case ActionView():
            return replace(view, affordance=veiled_action(view.affordance, judge))


def veiled_property(one: PropertyAffordance, judge: Judge) -> PropertyAffordance:
    """A property with what may be done with it."""
    read = one.read and judge.may_read(one.url)
    return replace(one, read=read, observe=one.observe and read, write=one.write and judge.may("PUT", one.url))


def veiled_action(one: ActionAffordance, judge: Judge) -> ActionAffordance:
    """An action, which without a request is one that cannot be called."""
    return one if judge.may("POST", one.url) else replace(one, request=None)


def _readable(url: str | None, judge: Judge) -> str | None:
    return url if url is not None and judge.may_read(url) else None
