"""What a mapping names that is not there, or cannot be offered, as far as the robot is known. Pure.

It is no error: what is not there yet appears when the robot has it. But a name that is misspelt never does.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from difflib import get_close_matches
from typing import TYPE_CHECKING

from rosld.server.hypermedia.mapping import ComplexResource, MappedAction, MappedProperty
from rosld.server.hypermedia.value_shape import has_scalar

if TYPE_CHECKING:
    from rosld.server.hypermedia.resource_tree import ResourceTree

_MAX_NAMES = 5_000
"""Names among which one that is much like another is looked for."""


def warnings_of(resource: ComplexResource, tree: ResourceTree) -> tuple[str, ...]:
    """What of a complex resource of a mapping is not there or cannot be offered now: a sentence for each."""
    found = [
        *(words for one in resource.properties for words in _of_property(one, tree)),
        *(words for one in resource.actions for words in _of_action(resource, one, tree)),
        *(f"map:target {one.target}: no resource is there" for one in resource.links if one.target not in tree.paths),
        *_of_conditions(resource, tree),
        *_of_stops(resource, tree),
    ]
    return tuple(f"{resource.path}: {words}." for words in dict.fromkeys(found))


def _of_property(mapped: MappedProperty, tree: ResourceTree) -> Iterator[str]:
    properties = tree.catalogue.properties
    found = properties.get(mapped.member)
    if found is None:
        yield f"map:member {mapped.member}: nothing of this name has a value" + _near(mapped.member, properties)
    elif mapped.field is not None and not has_scalar(found.kind, mapped.field):
        yield f"map:field {mapped.field}: {mapped.member} has no such scalar"
    elif mapped.writable_when and not found.writers:
        yield f"map:writableWhen of {mapped.member}: nothing writes it"


def _of_action(resource: ComplexResource, mapped: MappedAction, tree: ResourceTree) -> Iterator[str]:
    plan = tree.action(resource.path + mapped.name)
    if plan is None:
        yield f"map:service {mapped.service}: there is no such service or action" + _near(
            mapped.service, tree.invocable
        )
    elif plan.schema is None:
        yield f"map:service {mapped.service}: it cannot be offered, for its type is not known"


def _of_conditions(resource: ComplexResource, tree: ResourceTree) -> Iterator[str]:
    for condition in resource.all_conditions():
        about = condition.about
        if about not in (tree.paths if about.endswith("/") else tree.catalogue.properties):
            yield f"map:about {about}: nothing is there, so the condition never holds"


def _of_stops(resource: ComplexResource, tree: ResourceTree) -> Iterator[str]:
    for stop in (each.command for each in resource.stops):
        if stop.service is not None and stop.service not in tree.invocable:
            yield f"map:call {stop.service}: there is no such service" + _near(stop.service, tree.invocable)
        if stop.topic is not None and stop.topic not in tree.catalogue.by_topic:
            yield f"map:publish {stop.topic}: there is no such topic" + _near(stop.topic, tree.catalogue.by_topic)


def _near(name: str, names: Iterable[str]) -> str:
    """The name that is most like one that is not there, in words; nothing where none is."""
    known = list(names)
    close = get_close_matches(name, known, 1, 0.75) if len(known) <= _MAX_NAMES else ()
    return f" (there is {close[0]})" if close else ""
