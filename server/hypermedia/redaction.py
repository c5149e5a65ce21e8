"""Views as they may be seen: what is on offer to one who may not do everything. Pure."""

from __future__ import annotations

from dataclasses import replace
from typing import overload

from rosld.server.auth.permissions import Permissions
from rosld.server.hypermedia.views import (
    ActionAffordance,
    ActionView,
    ComplexView,
    PropertyAffordance,
    PropertyView,
    View,
)


@overload
def veiled_view(view: ComplexView, permissions: Permissions) -> ComplexView: ...
@overload
def veiled_view(view: View, permissions: Permissions) -> View: ...
def veiled_view(view: View, permissions: Permissions) -> View:
    """A view without what may not be read, and with what may be done as far as the agent may do it."""
    match view:
        case ComplexView():
            return replace(
                view,
                members=tuple(
                    replace(member, affordance=veiled_property(member.affordance, permissions))
                    for member in view.members
                    if permissions.may_read(member.affordance.url)
                ),
                actions=tuple(action for action in view.actions if permissions.may("POST", action.url)),
                links=tuple(link for link in view.links if permissions.may_read(link.target)),
                children=tuple(filter(permissions.may_read, view.children)),
                parent=_readable(view.parent, permissions),
                mapping=_readable(view.mapping, permissions),
            )
        case PropertyView():
            return replace(
                view,
                affordance=veiled_property(view.affordance, permissions),
                reads_from=tuple(filter(permissions.may_read, view.reads_from)),
                writes_to=tuple(filter(permissions.may_read, view.writes_to)),
            )
        case ActionView():
            return replace(view, affordance=veiled_action(view.affordance, permissions))


def veiled_property(one: PropertyAffordance, permissions: Permissions) -> PropertyAffordance:
    """A property with what may be done with it."""
    read = one.read and permissions.may_read(one.url)
    return replace(one, read=read, observe=one.observe and read, write=one.write and permissions.may("PUT", one.url))


def veiled_action(one: ActionAffordance, permissions: Permissions) -> ActionAffordance:
    """An action, which without a request is one that cannot be called."""
    return one if permissions.may("POST", one.url) else replace(one, request=None)


def _readable(url: str | None, permissions: Permissions) -> str | None:
    return url if url is not None and permissions.may_read(url) else None
