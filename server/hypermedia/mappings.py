"""The mappings in force: documents by URL, and the mapping set that they form; lookups are pure."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Iterator, Mapping
from types import MappingProxyType

from msgspec import Struct

from rosld.ontology.names import IdentityCache
from rosld.ontology.violations import Violation
from rosld.server.hypermedia.mapping import ComplexResource, Condition, MappedAction, MappingSet
from rosld.server.hypermedia.mapping_parser import InvalidMapping, MappingDocument


class Mappings:
    """The documents in force. Changes are atomic, and values returned earlier never change.

    `given` are the initial ones. Changes of stored documents require the `lock`.
    """

    def __init__(self, initial: Iterable[MappingDocument] = ()) -> None:
        self.documents: Mapping[str, MappingDocument] = MappingProxyType({})
        """The documents by URL, in the order in which they came into force."""
        self.mapping_set = MappingSet()
        """The joint content of all documents."""
        self.given = tuple(initial)
        self.lock = asyncio.Lock()
        for document in self.given:
            self.replace(document)

    def replace(self, document: MappingDocument) -> None:
        """Put a document into force, replacing the one with the same URL.

        Raises InvalidMapping, and changes nothing, if another document defines the same path or condition.
        """
        self.check(document)
        self._become({**self.documents, document.url: document})

    def check(self, document: MappingDocument) -> None:
        """Raise InvalidMapping if `replace` would."""
        _check(document, [each for url, each in self.documents.items() if url != document.url])

    def remove(self, url: str) -> None:
        """Remove the document with this URL, if it exists."""
        if url in self.documents:
            self._become({each: document for each, document in self.documents.items() if each != url})

    def _become(self, documents: Mapping[str, MappingDocument]) -> None:
        resources = {one.path: one for document in documents.values() for one in document.resources}
        mapping_set = MappingSet(self.mapping_set.revision + 1, MappingProxyType(resources))
        self.documents, self.mapping_set = MappingProxyType(documents), mapping_set


def _check(document: MappingDocument, others: Iterable[MappingDocument]) -> None:
    """Raise InvalidMapping if a document defines a path or condition of another one."""
    paths, conditions = _claims(document)
    found: list[Violation] = []
    about: list[str] = []
    for other in others:
        taken, named = _claims(other)
        about += [other.url] if paths & taken or conditions & named else []
        for path in sorted(paths & taken):
            found.append(Violation(path, f"{other.url} already defines this path; change or delete that one"))
        for iri in sorted(conditions & named):
            found.append(Violation(iri, f"{other.url} already describes this condition; give this one its own IRI"))
    if found:
        raise InvalidMapping(*found, about=tuple(about))


def _claims(document: MappingDocument) -> tuple[set[str], set[str]]:
    """Return the paths and the IRIs of conditions that a document defines."""
    resources = document.resources
    return {one.path for one in resources}, {each.iri for one in resources for each in one.all_conditions()}


class _Index(Struct, frozen=True):
    """The indexes of a mapping set."""

    guards: Mapping[str, tuple[Condition, ...]]
    services: Mapping[str, list[tuple[ComplexResource, MappedAction]]]
    dependents: Mapping[str, frozenset[str]]
    components: Mapping[str, frozenset[str]]
    related: Mapping[str, frozenset[str]]
    relations: frozenset[str]


def relations(mapping_set: MappingSet) -> frozenset[str]:
    """Return the IRIs of all predicates in mappings: the same object until the mappings change."""
    return _index(mapping_set).relations


def related(mapping_set: MappingSet, relation: str) -> frozenset[str]:
    """Return the paths of the complex resources that mappings give this predicate, by its IRI."""
    return _index(mapping_set).related.get(relation, frozenset())


def write_conditions_of(mapping_set: MappingSet, name: str) -> tuple[Condition, ...]:
    """Return all conditions for writing a member, from every mapping that maps it, by full name."""
    return _index(mapping_set).guards.get(name, ())


def actions_by_service(mapping_set: MappingSet) -> Mapping[str, list[tuple[ComplexResource, MappedAction]]]:
    """Return the actions that each service is offered as, by full name."""
    return _index(mapping_set).services


def members_of(resource: ComplexResource) -> frozenset[str]:
    """Return the full names of the members whose values a complex resource shows."""
    return frozenset(one.member for one in resource.properties)


def dependents(mapping_set: MappingSet, about: str) -> frozenset[str]:
    """Return the paths of the complex resources with a condition about this path or name."""
    return _index(mapping_set).dependents.get(about, frozenset())


def connected_paths(mapping_set: MappingSet, path: str) -> frozenset[str]:
    """Return the paths connected with this one by conditions, including itself.

    Connections lead from a complex resource to the subjects of its conditions, in any number of steps and in both
    directions. A condition about a property connects the complex resources that show it and the one that contains it.
    """
    return _index(mapping_set).components.get(path) or frozenset({path})


def mapped_above(mapping_set: MappingSet, path: str) -> tuple[ComplexResource, ...]:
    """Return the mapped resources at and above a path or name, the outermost first."""
    above = (path[: position + 1] for position, char in enumerate(path) if char == "/")
    return tuple(mapping_set.resources[each] for each in above if each in mapping_set.resources)


def _make_index(mapping_set: MappingSet) -> _Index:
    guards: dict[str, dict[str, Condition]] = {}
    services: dict[str, list[tuple[ComplexResource, MappedAction]]] = {}
    concerned: dict[str, set[str]] = {}
    related: dict[str, set[str]] = {}
    for resource in mapping_set.resources.values():
        given = (*(one.predicate for one in resource.properties), *(one.relation for one in resource.actions))
        for relation in (*given, *(one.relation for one in resource.links)):
            related.setdefault(relation.value, set()).add(resource.path)
        for one in resource.properties:
            guards.setdefault(one.member, {}).update((each.iri, each) for each in one.writable_when)
        for action in resource.actions:
            services.setdefault(action.service, []).append((resource, action))
        for condition in resource.all_conditions():
            concerned.setdefault(condition.about, set()).add(resource.path)
    return _Index(
        {member: tuple(found.values()) for member, found in guards.items()},
        services,
        {about: frozenset(paths) for about, paths in concerned.items()},
        _components(mapping_set, concerned),
        {relation: frozenset(paths) for relation, paths in related.items()},
        frozenset(related),
    )


_index: Callable[[MappingSet], _Index] = IdentityCache(_make_index)


def _components(mapping_set: MappingSet, concerned: Mapping[str, Iterable[str]]) -> Mapping[str, frozenset[str]]:
    """Return the component of every path in conditions; `concerned` maps their subjects to the paths that have them."""
    shown: dict[str, set[str]] = {}
    for resource in mapping_set.resources.values():
        for member in members_of(resource):
            shown.setdefault(member, {_home(member)}).add(resource.path)
    neighbours: dict[str, set[str]] = {}
    for about, paths in concerned.items():
        places = () if about.endswith("/") else shown.get(about, {_home(about)})
        for other in (*paths, *places):
            neighbours.setdefault(about, set()).add(other)
            neighbours.setdefault(other, set()).add(about)
    found: dict[str, frozenset[str]] = {}
    for start in neighbours:
        if start not in found:
            together = set(_reachable(start, neighbours))
            paths = frozenset(each for each in together if each.endswith("/"))
            found |= dict.fromkeys(together, paths)
    return found


def _home(name: str) -> str:
    """Return the path of the complex resource that contains a name."""
    return name.rpartition("/")[0] + "/"


def _reachable(start: str, neighbours: Mapping[str, Iterable[str]]) -> Iterator[str]:
    waiting, seen = [start], {start}
    while waiting:
        place = waiting.pop()
        yield place
        new = [each for each in neighbours[place] if each not in seen]
        seen.update(new)
        waiting += new
