"""The resource tree: plans of all URLs below `/resources/`, from the catalogue and the mappings in force. Pure.

A plan lists the parts of a resource and the properties to be read for its state; it does not depend on the state of the
robot. Plans are created on first use and cached in the tree.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import NamedNode

from rosld.adapters.model import ActionSchema, Kind, MessageSchema, ServiceSchema
from rosld.ontology.names import Members
from rosld.server.hypermedia.catalogue import Catalogue, Getter, GoalPart, GoalSource, Property, Setter
from rosld.server.hypermedia.mapping import ComplexResource, Condition, MappedLink, MappedProperty, MappingSet
from rosld.server.hypermedia.mapping_check import warnings_of
from rosld.server.hypermedia.mappings import (
    actions_by_service,
    connected_paths,
    dependents,
    mapped_above,
    members_of,
    write_conditions_of,
)
from rosld.server.runtime.version_cache import VersionCache

_P = TypeVar("_P")
_MAX_AFFECTED = 10_000


class MemberPlan(Struct, frozen=True):
    """A property within a complex resource: its key and its mapping (None if it has none).

    `at` is the full name of its own resource; None if another property has that name.
    """

    name: str
    source: Property
    url_name: str | None
    write_conditions: tuple[Condition, ...]
    mapped: MappedProperty | None = None

    @property
    def field(self) -> str | None:
        """The single scalar of the property's value that is shown."""
        return self.mapped.field if self.mapped is not None else None


class ActionPlan(Struct, frozen=True):
    """An action by its full name; it is on offer while all of `exists_when` and `conditions` hold.

    `service` is the service that it calls, or (`sends_goals`) the ROS action that it sends goals to. `schema` is None
    if the type of that is unknown. `parts` are the properties for the state of its goal.
    """

    name: str
    service: str
    schema: ServiceSchema | ActionSchema | None
    relation: NamedNode | None
    exists_when: tuple[Condition, ...]
    conditions: tuple[Condition, ...]
    reads: tuple[Property, ...]
    sends_goals: bool = False
    parts: tuple[Property, ...] = ()

    @property
    def request(self) -> MessageSchema | None:
        match self.schema:
            case ActionSchema(goal=goal):
                return goal
            case ServiceSchema(request=request):
                return request
        return None

    @property
    def parent(self) -> str:
        """The path of the complex resource that contains it."""
        return parent_of_name(self.name)


class LinkPlan(Struct, frozen=True):
    """A link; `conditions` include those under which its target exists."""

    relation: NamedNode
    target: str
    conditions: tuple[Condition, ...]


class ChildPlan(Struct, frozen=True):
    """A complex resource directly below; it is contained while all conditions hold."""

    path: str
    conditions: tuple[Condition, ...]


class ComplexPlan(Struct, frozen=True):
    """A complex resource. `reads` are all properties that determine its state and its offers.

    `warnings` are about parts of its mapping that are missing or cannot be offered.
    """

    path: str
    members: tuple[MemberPlan, ...]
    actions: tuple[ActionPlan, ...]
    links: tuple[LinkPlan, ...]
    children: tuple[ChildPlan, ...]
    exists_when: tuple[Condition, ...]
    mapped: ComplexResource | None
    reads: tuple[Property, ...]
    is_conditional: bool
    warnings: tuple[str, ...] = ()

    @property
    def parent(self) -> str | None:
        """The path of the complex resource above."""
        return parent_of(self.path)


class PropertyPlan(Struct, frozen=True):
    """A property, or one field of it under a name defined by a mapping."""

    name: str
    source: Property
    exists_when: tuple[Condition, ...]
    write_conditions: tuple[Condition, ...]
    mapped: MappedProperty | None
    reads: tuple[Property, ...]

    @property
    def parent(self) -> str:
        """The path of the complex resource that contains it."""
        return parent_of_name(self.name)

    @property
    def member(self) -> MemberPlan:
        """The property as a member of its complex resource."""
        return MemberPlan(self.name.rpartition("/")[2], self.source, self.name, self.write_conditions, self.mapped)

    @property
    def is_conditional(self) -> bool:
        """Whether its affordances depend on conditions."""
        return bool(self.exists_when or self.write_conditions)


def path_of(namespace: tuple[str, ...]) -> str:
    """Return the path of a namespace: `/aircraft/` for `("aircraft",)`, `/` for none."""
    return "/" + "".join(f"{segment}/" for segment in namespace)


def segments_of(path: str) -> tuple[str, ...]:
    """Return the segments of a path: the inverse of `path_of`."""
    return tuple(path[1:-1].split("/")) if path != "/" else ()


def parent_of(path: str) -> str | None:
    """Return the path of the complex resource above; None for `/`."""
    return None if path == "/" else path[:-1].rpartition("/")[0] + "/"


def parent_of_name(name: str) -> str:
    """Return the path of the complex resource that contains a name: `/aircraft/` for `/aircraft/power`."""
    return name.rpartition("/")[0] + "/"


class ResourceTree:
    """The resources of one catalogue and one set of mappings."""

    def __init__(self, catalogue: Catalogue, mapping_set: MappingSet) -> None:
        self.catalogue = catalogue
        self.mapping_set = mapping_set
        self._claimed = actions_by_service(mapping_set)
        self._named = {
            resource.path + action.name: action
            for resource in mapping_set.resources.values()
            for action in resource.actions
        }
        self._picked = {
            resource.path + one.name: one
            for resource in mapping_set.resources.values()
            for one in resource.properties
            if one.field is not None and resource.path + one.name not in catalogue.properties
        }
        self._children = _children(catalogue.namespaces, mapping_set)
        self._schemas = _schemas(catalogue)
        self.invocable: dict[str, bool] = {action.service: action.sends_goals for action in catalogue.actions.values()}
        self.invocable |= dict.fromkeys(self._schemas.keys() - self.invocable.keys(), False)
        self._complexes: dict[str, ComplexPlan | None] = {}
        self._properties: dict[str, PropertyPlan | None] = {}
        self._actions: dict[str, ActionPlan | None] = {}
        self._affected = VersionCache[frozenset[str]](_MAX_AFFECTED)

    @property
    def paths(self) -> Iterable[str]:
        """The paths of all complex resources that may exist."""
        return self._children

    @property
    def properties(self) -> Iterable[str]:
        """The names of all properties that may exist."""
        return self.catalogue.properties.keys() | self._picked.keys()

    @property
    def actions(self) -> Iterable[str]:
        """The names of all actions that may exist."""
        derived = (name for name, one in self.catalogue.actions.items() if one.service not in self._claimed)
        return self._named.keys() | derived

    def complex(self, path: str) -> ComplexPlan | None:
        """Return the complex resource at a path, or None."""
        return _get_or_make(self._complexes, path, self._complex)

    def property(self, name: str) -> PropertyPlan | None:
        """Return the property with a name, or None."""
        return _get_or_make(self._properties, name, self._property)

    def action(self, name: str) -> ActionPlan | None:
        """Return the action with a name, or None."""
        return _get_or_make(self._actions, name, self._action)

    def exists_when(self, path: str) -> tuple[Condition, ...]:
        """Return the conditions for the existence of the resource at a path and everything below it."""
        return _once(each for resource in mapped_above(self.mapping_set, path) for each in resource.exists_when)

    def state_properties(self, about: str) -> tuple[Property, ...]:
        """Return the properties that are the state of a complex resource (a path) or of a property (a name)."""
        if not about.endswith("/"):
            found = self.catalogue.properties.get(about)
            return () if found is None else (found,)
        mapped = self.mapping_set.resources.get(about)
        if mapped is not None:
            there = (self.catalogue.properties.get(one.member) for one in mapped.properties)
            return tuple(one for one in there if one is not None)
        members = self.catalogue.namespaces.get(segments_of(about), Members())
        return tuple(
            self.catalogue.properties[about + leaf]
            for leaf in members.leaves
            if about + leaf in self.catalogue.properties
        )

    def properties_in(self, conditions: Iterable[Condition]) -> tuple[Property, ...]:
        """Return the properties that must be read to evaluate these conditions."""
        return self._reads((), conditions)

    def lock_names(self, names: Iterable[str]) -> tuple[str, ...]:
        """Return the names that a write to these names must lock, in the order that all writes use.

        Empty if no condition is connected with them.
        """
        paths = {path for name in names for path in self._affected_resources(name)}
        components = (connected_paths(self.mapping_set, path) for path in paths)
        return tuple(sorted({min(found) for found in components if len(found) > 1 or _has_conditions(self, found)}))

    def affected_by(self, kind: Kind, name: str) -> frozenset[str]:
        """Return the properties whose values a write to a topic, service or parameter may change.

        These are the properties of its complex resources, of every resource with a condition about one of them, and the
        subjects of their conditions: a write that depends on a state is likely to change it.
        """
        return self._affected.get_or_make((kind, name), None, lambda: self._find_affected(kind, name))

    def _find_affected(self, kind: Kind, name: str) -> frozenset[str]:
        ways = {Kind.TOPIC: self.catalogue.by_topic, Kind.SERVICE: self.catalogue.by_service}
        own = ways.get(kind, self.catalogue.by_parameter).get(name, name)
        paths = {parent_of_name(name), *self._affected_resources(own)}
        if kind is Kind.SERVICE:
            paths |= {resource.path for resource, _ in self._claimed.get(name, ())}
        paths |= {path for each in (*paths, own) for path in dependents(self.mapping_set, each)}
        judged = {condition.about for path in paths for condition in self._conditions(path)}
        return frozenset({own, *(one.name for each in (*paths, *judged) for one in self.state_properties(each))})

    def _conditions(self, path: str) -> Iterator[Condition]:
        """Yield the conditions of a complex resource and everything it offers."""
        yield from self.exists_when(path)
        mapped = self.mapping_set.resources.get(path)
        if mapped is not None:
            yield from mapped.conditions()

    def _affected_resources(self, name: str) -> frozenset[str]:
        """Return the complex resources that contain a property or action, and those with conditions about it."""
        mapping = {resource.path for resource in self.mapping_set.resources.values() if name in members_of(resource)}
        return frozenset({parent_of_name(name), *mapping, *dependents(self.mapping_set, name)})

    def _reads(self, own: Iterable[Property], conditions: Iterable[Condition]) -> tuple[Property, ...]:
        found = {one.name: one for one in own}
        for condition in conditions:
            found |= {one.name: one for one in self.state_properties(condition.about)}
        return tuple(found.values())

    def _complex(self, path: str) -> ComplexPlan | None:
        if path not in self._children:
            return None
        mapped = self.mapping_set.resources.get(path)
        members = self._derived_members(path) if mapped is None else self._mapped_members(mapped)
        actions = self._derived_actions(path) if mapped is None else self._mapped_actions(mapped)
        links = () if mapped is None else tuple(map(self._link, mapped.links))
        closed = {child for child in self._children[path] if mapped is None or child in self.mapping_set.resources}
        hidden = {link.target: link.conditions for link in links}
        children = tuple(
            ChildPlan(child, _once((*self.exists_when(child), *hidden.get(child, ())))) for child in sorted(closed)
        )
        exists = self.exists_when(path)
        conditions = _once(
            (
                *exists,
                *(each for one in members for each in one.write_conditions),
                *(each for action in actions for each in action.conditions),
                *(each for link in links for each in link.conditions),
                *(each for child in children for each in child.conditions),
            )
        )
        reads = self._reads((one.source for one in members), conditions)
        warnings = () if mapped is None else warnings_of(mapped, self)
        return ComplexPlan(path, members, actions, links, children, exists, mapped, reads, bool(conditions), warnings)

    def _derived_members(self, path: str) -> tuple[MemberPlan, ...]:
        properties = self.state_properties(path)
        return tuple(
            MemberPlan(
                one.name[len(path) :], self._unclaimed(one), one.name, write_conditions_of(self.mapping_set, one.name)
            )
            for one in properties
        )

    def _mapped_members(self, mapped: ComplexResource) -> tuple[MemberPlan, ...]:
        found = []
        for one in mapped.properties:
            member = self.catalogue.properties.get(one.member)
            if member is not None:
                guards = write_conditions_of(self.mapping_set, one.member)
                at = one.member if one.field is None else mapped.path + one.name
                free = one.field is None or self._picked.get(at) is one
                found.append(MemberPlan(one.name, self._unclaimed(member), at if free else None, guards, one))
        return tuple(found)

    def _derived_actions(self, path: str) -> tuple[ActionPlan, ...]:
        members = self.catalogue.namespaces.get(segments_of(path), Members())
        found = (self.action(path + leaf) for leaf in members.leaves)
        return tuple(one for one in found if one is not None)

    def _mapped_actions(self, mapped: ComplexResource) -> tuple[ActionPlan, ...]:
        found = (self.action(mapped.path + action.name) for action in mapped.actions)
        return tuple(one for one in found if one is not None)

    def _link(self, link: MappedLink) -> LinkPlan:
        return LinkPlan(link.relation, link.target, _once((*link.available_when, *self.exists_when(link.target))))

    def _property(self, name: str) -> PropertyPlan | None:
        home = parent_of_name(name)
        mapped = self._picked.get(name) or self._as_mapped(home, name)
        member = name if mapped is None else mapped.member
        found = self.catalogue.properties.get(member)
        if found is None:
            return None
        exists, guards = self.exists_when(home), write_conditions_of(self.mapping_set, member)
        return PropertyPlan(
            name, self._unclaimed(found), exists, guards, mapped, self._reads((found,), (*exists, *guards))
        )

    def _as_mapped(self, path: str, name: str) -> MappedProperty | None:
        """Return the plan for the mapping of a path and one of its members."""
        resource = self.mapping_set.resources.get(path)
        properties = resource.properties if resource is not None else ()
        return next((one for one in properties if one.member == name and one.field is None), None)

    def redirect_target(self, name: str) -> str | None:
        """Return the resource that a missing one is known as: with a final slash, or by the name in a mapping."""
        actions = (home.path + action.name for home, action in self._claimed.get(name, ()))
        home = self.mapping_set.resources.get(parent_of_name(name))
        called = () if home is None else (one.member for one in home.properties if home.path + one.name == name)
        found = (one for one in (*actions, f"{name}/", *called) if one != name)
        return next((one for one in found if one in self.paths or self.property(one) or self.action(one)), None)

    def names_of(self, name: str) -> Iterator[tuple[str, str | None]]:
        """Yield the names of the resources of a property, each with the field shown there (None for all of it)."""
        yield name, None
        for at, mapped in self._picked.items():
            if mapped.member == name:
                yield at, mapped.field

    def _action(self, name: str) -> ActionPlan | None:
        action = self._named.get(name)
        if action is not None:
            service, relation, conditions = action.service, action.relation, action.available_when
            if service not in self.invocable:
                return None
        else:
            derived = self.catalogue.actions.get(name)
            if derived is None or derived.service in self._claimed:
                return None
            service, relation, conditions = derived.service, None, ()
        exists = self.exists_when(parent_of_name(name))
        sends_goals = self.invocable[service]
        return ActionPlan(
            name, service, self._schemas.get(service), relation, exists, conditions,
            self._reads((), (*exists, *conditions)), sends_goals, self._parts(service) if sends_goals else (),
        )  # fmt: skip

    def _parts(self, action: str) -> tuple[Property, ...]:
        """Return the properties for the goal of a ROS action whose names are not taken otherwise."""
        found = (self.catalogue.properties.get(f"{action}/{part.value}") for part in GoalPart)
        return tuple(one for one in found if one is not None and isinstance(one.readers[0], GoalSource))

    def _unclaimed(self, found: Property) -> Property:
        """Return the property without the writers that a mapping offers as actions, where conditions guard them."""
        writers = tuple(one for one in found.writers if one.name not in self._claimed)
        return found if len(writers) == len(found.writers) else replace(found, writers=writers)


def _children(namespaces: Iterable[tuple[str, ...]], mapping_set: MappingSet) -> dict[str, set[str]]:
    """Return the paths directly below each path, derived and mapped; `/` always exists."""
    found: dict[str, set[str]] = {"/": set()}
    for path in (*map(path_of, namespaces), *mapping_set.resources):
        while path not in found:
            found[path] = set()
            path = parent_of(path) or "/"
    for path in found:
        above = parent_of(path)
        if above is not None:
            found[above].add(path)
    return found


def _has_conditions(tree: ResourceTree, paths: Iterable[str]) -> bool:
    return any(
        any(tree.mapping_set.resources[path].conditions()) for path in paths if path in tree.mapping_set.resources
    )


def _schemas(catalogue: Catalogue) -> dict[str, ServiceSchema | ActionSchema]:
    """Return the types of all services and actions with a known type, by name."""
    found = {action.service: action.schema for action in catalogue.actions.values() if action.schema is not None}
    for one in catalogue.properties.values():
        found |= {way.name: way.schema for way in (*one.readers, *one.writers) if isinstance(way, Getter | Setter)}
    return found


def _once(conditions: Iterable[Condition]) -> tuple[Condition, ...]:
    return tuple({condition.iri: condition for condition in conditions}.values())


def _get_or_make(cache: dict[str, _P | None], key: str, make: Callable[[str], _P | None]) -> _P | None:
    """Return a cached value or create it; None is not cached, because the number of missing names is unlimited."""
    found = cache.get(key)
    if found is None:
        found = make(key)
        if found is not None:
            cache[key] = found
    return found
