"""Views: the state of the resources of `/resources/` at one moment, as values.

`affordance_service.py` creates them, `view_documents.py` writes them as RDF, `thing_description.py` as Thing
Descriptions, the pages as HTML. URLs are absolute. `redact` returns a view without content that the agent may not read
and operations that it may not use.
"""

from __future__ import annotations

from typing import TypeAlias

from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import NamedNode

from rosld.adapters.model import MessageSchema
from rosld.server.auth.errors import WITHHELD
from rosld.server.auth.permissions import Permissions
from rosld.server.hypermedia.value import Reading
from rosld.shapes.value import ValueShape


def _redact_reading(reading: Reading, permissions: Permissions) -> Reading:
    """Return a reading without its failure if the agent may not read the sources."""
    if reading.failure is None or all(map(permissions.may_read, reading.about)):
        return reading
    return replace(reading, failure=WITHHELD, words=None, about=())


class PropertyAffordance(Struct, frozen=True):
    """The affordance of a property: `shape` is the shape of values read and sent.

    `name` is its key in plain JSON, `predicate` its relation in a complex resource (None without a mapping). `write`
    and `read` are the operations available now (in a Thing Description: ever). `observe`: its changes can be streamed.
    `hold` is the URL of the topic that can be held, if it takes velocity commands.
    """

    name: str
    url: str
    shape: ValueShape
    predicate: NamedNode | None = None
    read: bool = True
    write: bool = False
    observe: bool = False
    title: str | None = None
    description: str | None = None
    hold: str | None = None

    def redact(self, permissions: Permissions) -> PropertyAffordance:
        """Return the affordance without the interactions that the agent may not use."""
        read, write = self.read and permissions.may_read(self.url), self.write and permissions.may("PUT", self.url)
        hold = self.hold if self.hold is not None and permissions.may("POST", self.hold) else None
        return replace(self, read=read, observe=self.observe and read, write=write, hold=hold)


class GoalAffordance(Struct, frozen=True):
    """The operations on the goals of a ROS action: read the state of its goal at `status`, cancel it (DELETE).

    `feedback` and `result` are their types, None if unknown.
    """

    status: str | None
    can_cancel: bool
    feedback: MessageSchema | None
    result: MessageSchema | None

    def redact(self, permissions: Permissions, url: str) -> GoalAffordance:
        """Return it without the status that the agent may not read or the cancellation it may not request at `url`."""
        may_read = self.status is not None and permissions.may_read(self.status)
        can_cancel = self.can_cancel and permissions.may("DELETE", url)
        return replace(self, status=self.status if may_read else None, can_cancel=can_cancel)


class ActionAffordance(Struct, frozen=True):
    """The affordance of an action: POST to `url` with a message of `request` (None if its type is unknown).

    `goals`: an invocation creates a goal. `is_open`: it may be invoked now.
    """

    name: str
    url: str
    request: MessageSchema | None
    relation: NamedNode | None = None
    title: str | None = None
    goals: GoalAffordance | None = None
    is_open: bool = True

    def redact(self, permissions: Permissions) -> ActionAffordance:
        """Return the affordance without the request and the goals that the agent may not use."""
        goals = None if self.goals is None else self.goals.redact(permissions, self.url)
        request = self.request if permissions.may("POST", self.url) else None
        return self if request is self.request and goals == self.goals else replace(self, request=request, goals=goals)


class LinkAffordance(Struct, frozen=True):
    """A link: `target` is the URL of another resource."""

    relation: NamedNode
    target: str


class Member(Struct, frozen=True):
    """A property within a complex resource with its reading; `field` selects one scalar of it."""

    affordance: PropertyAffordance
    reading: Reading
    field: str | None = None


class PropertyView(Struct, frozen=True):
    """A single property (`/resources/aircraft/power`).

    `reads_from` and `writes_to`: the URLs of the ROS topics, services and parameters behind it; `part_of`: the URL of
    its complex resource; `field`: the single scalar it shows.
    """

    affordance: PropertyAffordance
    reading: Reading
    reads_from: tuple[str, ...]
    writes_to: tuple[str, ...]
    part_of: str
    field: str | None = None

    def redact(self, permissions: Permissions) -> PropertyView:
        """Return the view without the URLs that the agent may not read."""
        return replace(
            self,
            affordance=self.affordance.redact(permissions),
            reading=_redact_reading(self.reading, permissions),
            reads_from=tuple(filter(permissions.may_read, self.reads_from)),
            writes_to=tuple(filter(permissions.may_read, self.writes_to)),
        )


class ActionView(Struct, frozen=True):
    """A single action (`/resources/aircraft/start`); `invokes` is the URL of its ROS service or action.

    `invokes` is None if the agent may not read it. `parts` are the state of the goal of a ROS action.
    """

    affordance: ActionAffordance
    invokes: str | None
    part_of: str
    parts: tuple[PropertyAffordance, ...] = ()

    def redact(self, permissions: Permissions) -> ActionView:
        """Return the view without operations that the agent may not use and parts that it may not read."""
        parts = tuple(one.redact(permissions) for one in self.parts if permissions.may_read(one.url))
        invokes = self.invokes if self.invokes is not None and permissions.may_read(self.invokes) else None
        return replace(self, affordance=self.affordance.redact(permissions), invokes=invokes, parts=parts)


class ComplexView(Struct, frozen=True):
    """A complex resource (`/resources/aircraft/`) with everything that is on offer now.

    `children`: the URLs of the complex resources directly below, `parent`: that of the one above; `mapping`: the IRI of
    the mapping that arranges it, None if it is derived from names alone; `warnings`: the missing parts of the mapping.
    """

    url: str
    path: str
    members: tuple[Member, ...] = ()
    actions: tuple[ActionAffordance, ...] = ()
    links: tuple[LinkAffordance, ...] = ()
    children: tuple[str, ...] = ()
    parent: str | None = None
    title: str | None = None
    mapping: str | None = None
    warnings: tuple[str, ...] = ()

    def redact(self, permissions: Permissions) -> ComplexView:
        """Return the view without members, actions, links and children that the agent may not use.

        Warnings are omitted altogether: their text may name any resource.
        """
        return replace(
            self,
            warnings=(),
            members=tuple(
                replace(
                    member,
                    affordance=member.affordance.redact(permissions),
                    reading=_redact_reading(member.reading, permissions),
                )
                for member in self.members
                if permissions.may_read(member.affordance.url)
            ),
            actions=tuple(action for action in self.actions if permissions.may("POST", action.url)),
            links=tuple(link for link in self.links if permissions.may_read(link.target)),
            children=tuple(filter(permissions.may_read, self.children)),
            parent=self.parent if self.parent is not None and permissions.may_read(self.parent) else None,
            mapping=self.mapping if self.mapping is not None and permissions.may_read(self.mapping) else None,
        )


View: TypeAlias = PropertyView | ActionView | ComplexView
