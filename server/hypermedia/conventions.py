"""Conventions: from the names of a robot to its resources (paper, section 4.2). Pure.

    /aircraft/get_power, /aircraft/set_power              one property   /aircraft/power
    /aircraft/engine/speed (a topic), .../set_speed       one property   /aircraft/engine/speed
    /aircraft/start                                       an action      /aircraft/start
    /aircraft/fly (an action of ROS)                      an action      /aircraft/fly, with the properties
                                                                         /aircraft/fly/status, goal, feedback, result

A template such as `get_{name}` only proposes; the types decide (`type_inference.py`). A service that is neither a
getter nor a setter is an action under its own name.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from fnmatch import translate
from functools import lru_cache
from types import MappingProxyType
from typing import TypeAlias, TypeVar

from msgspec import Struct
from pyoxigraph import Literal

from rosld.adapters.model import Action as RosAction
from rosld.adapters.model import (
    ActionSchema,
    GoalStatus,
    Graph,
    MessageSchema,
    Parameter,
    Primitive,
    Schema,
    Service,
    ServiceSchema,
    Topic,
    TypeRef,
)
from rosld.adapters.model.names import action_of
from rosld.ontology.names import members_of
from rosld.server.hypermedia.catalogue import (
    IDLE,
    Action,
    Catalogue,
    Getter,
    GoalPart,
    GoalSource,
    ParameterSource,
    Property,
    Reader,
    Setter,
    TopicSource,
    Writer,
)
from rosld.server.hypermedia.type_inference import is_convertible, value_fields
from rosld.shapes.value import Bounds, OpenShape, ScalarShape, ValueShape, value_shape

SchemaOf: TypeAlias = Callable[[TypeRef], "Schema | None"]

_S = TypeVar("_S", Getter, Setter)
_Kind = TypeVar("_Kind", ServiceSchema, ActionSchema)

_PLACE = re.compile(r"\{([nN]ame)\}")
_ACTIONLIB = {
    "goal": "ActionGoal",
    "cancel": "actionlib_msgs/msg/GoalID",
    "status": "actionlib_msgs/msg/GoalStatusArray",
    "feedback": "ActionFeedback",
    "result": "ActionResult",
}
"""The topics of a ROS 1 action, and the suffixes of their types."""
_OF_ROS_2 = re.compile(r"use_sim_time|start_type_description_service|qos_overrides\..*", re.DOTALL)


class Conventions(Struct, frozen=True):
    """Rules for which services read and write which property, and which are in no resource.

    A template fits the last segments of a service's name: `{name}/get` makes `/arm/joint/get` read `/arm/joint`.
    `{Name}` is the capitalized name, as in JavaBeans: `getPower` reads `power`, `getURL` reads `URL`. `excluded` are
    globs of whole names, in which `*` also matches slashes. The first template that fits wins. Raises ValueError with a
    sentence for the user.
    """

    getters: tuple[str, ...]
    setters: tuple[str, ...]
    excluded: tuple[str, ...]

    def __post_init__(self) -> None:
        for template in (*self.getters, *self.setters):
            _check_template(template)
        for glob in self.excluded:
            _check_glob(glob)

    def extend(
        self, getters: Iterable[str] = (), setters: Iterable[str] = (), excluded: Iterable[str] = ()
    ) -> Conventions:
        """Return the conventions with more, which take precedence. Raises ValueError with a sentence for the user."""
        return Conventions(
            tuple(dict.fromkeys((*getters, *self.getters))),
            tuple(dict.fromkeys((*setters, *self.setters))),
            tuple(dict.fromkeys((*self.excluded, *excluded))),
        )

    def excludes(self, service: str) -> bool:
        """Whether a service or an action is in no resource."""
        return _any_of(self.excluded).match(service) is not None


def _check_template(template: str) -> None:
    if len(_PLACE.findall(template)) != 1:
        raise ValueError(
            f"The template {template!r} must contain {{name}} or {{Name}} exactly once, as 'get_{{name}}' does."
        )
    if _PLACE.fullmatch(template):
        raise ValueError(
            f"The template {template!r} matches every service: add a prefix or suffix, as in 'get_{{name}}'."
        )
    if "{" in (rest := _PLACE.sub("", template)) or "}" in rest:
        raise ValueError(f"The template {template!r} can contain no braces except {{name}} or {{Name}}.")
    if "" in template.split("/"):
        raise ValueError(f"The template {template!r} must not begin or end with a slash, or contain two in a row.")


def _check_glob(glob: str) -> None:
    if not glob.startswith(("/", "*", "?", "[")):
        raise ValueError(f"The glob {glob!r} matches no service, because names begin with a slash: try '*/{glob}'.")


CONVENTIONS = Conventions(
    getters=("get_{name}", "get{Name}", "{name}/get"),
    setters=("set_{name}", "set{Name}", "{name}/set"),
    excluded=(
        "*/get_loggers",
        "*/set_logger_level",
        "*/describe_parameters",
        "*/get_parameter_types",
        "*/get_parameters",
        "*/list_parameters",
        "*/set_parameters",  # of ROS 2, and of dynamic_reconfigure in ROS 1
        "*/set_parameters_atomically",
        "*/get_type_description",
        "*/_*",
    ),
)
"""Default conventions: common names of getters and setters, and the services that ROS gives every node."""


def every_node_has(parameter: Parameter) -> bool:
    """Whether a parameter is one that ROS 2 gives every node."""
    owner = parameter.node
    return owner is not None and _OF_ROS_2.fullmatch(parameter.name.removeprefix(f"{owner}/")) is not None


@lru_cache(maxsize=16)
def _any_of(globs: tuple[str, ...]) -> re.Pattern[str]:
    return re.compile("|".join(map(translate, globs)) or r"(?!)")


@lru_cache(maxsize=16)
def _patterns(templates: tuple[str, ...]) -> tuple[tuple[re.Pattern[str], bool], ...]:
    """Return the namespace and name in each template, and whether the name is capitalized."""
    found = []
    for template in templates:
        before, place, after = _PLACE.split(template)
        pattern = re.compile(f"(.*/){re.escape(before)}([^/]+){re.escape(after)}", re.DOTALL)
        found.append((pattern, place == "Name"))
    return tuple(found)


def _propose_name(templates: tuple[str, ...], service: str) -> tuple[str, int] | None:
    """Return the property that the first matching template proposes for a service, and the index of that template."""
    for rank, (pattern, capital) in enumerate(_patterns(templates)):
        fit = pattern.fullmatch(service)
        if fit is None:
            continue
        namespace, name = fit.groups()
        if not capital:
            return namespace + name, rank
        if name[0].isupper():
            return namespace + _decapitalize(name), rank
    return None


def _decapitalize(name: str) -> str:
    """Return the text with a small first letter, unless the second is a capital too (JavaBeans 8.8)."""
    return name if name[1:2].isupper() else name[0].lower() + name[1:]


def needed_types(graph: Graph, conventions: Conventions = CONVENTIONS) -> tuple[TypeRef, ...]:
    """Return the types whose schemas `catalogue` needs for this graph, without duplicates."""
    topics = (ref for topic in _topics(graph) for ref in topic.types)
    services = (service.type for service in graph.services.values() if not conventions.excludes(service.name))
    actions = (action.type for action in graph.actions.values() if not conventions.excludes(action.name))
    return tuple(dict.fromkeys((*topics, *(ref for ref in (*services, *actions) if ref is not None))))


def catalogue(graph: Graph, schema_of: SchemaOf, conventions: Conventions = CONVENTIONS) -> Catalogue:
    """Return the properties and actions of a graph. `schema_of` returns the schema of a type, or None if it is unknown.

    If several services could read one property, the getter is the first suitable one in the order of the templates; all
    others are actions. The same applies to setters.
    """
    services = _schemas(graph.services.values(), ServiceSchema, schema_of, conventions)
    topics = {topic.name: TopicSource(topic.name, _message_schema(topic.type, schema_of)) for topic in _topics(graph)}
    parameters = {
        parameter.name: ParameterSource(parameter.name)
        for parameter in graph.parameters.values()
        if not every_node_has(parameter)
    }
    getters = _by_property(services, conventions.getters, _getter)
    setters = _by_property(services, conventions.setters, _setter)
    pursued = _schemas(graph.actions.values(), ActionSchema, schema_of, conventions)
    properties = {part.name: part for name, schema in pursued.items() for part in _parts(name, schema)}
    properties |= {
        name: _property(name, topics.get(name), getters.get(name, ()), setters.get(name, ()), parameters.get(name))
        for name in {*topics, *getters, *setters, *parameters}
    }
    by_service = {
        source.name: name
        for name in {**getters, **setters}
        for source in (*properties[name].readers, *properties[name].writers)
        if isinstance(source, Getter | Setter)
    }
    actions = {name: Action(name, name, schema, sends_goals=True) for name, schema in pursued.items()}
    actions |= {name: Action(name, name, schema) for name, schema in services.items() if name not in by_service}
    return Catalogue(
        MappingProxyType(dict(sorted(properties.items()))),
        MappingProxyType(dict(sorted(actions.items()))),
        MappingProxyType(members_of({**properties, **actions})),
        MappingProxyType({name: name for name in topics}),
        MappingProxyType(by_service),
        MappingProxyType({name: name for name in parameters}),
    )


def _topics(graph: Graph) -> Iterator[Topic]:
    """Return the topics in resources: all except those of actions of ROS 2 and of actionlib."""
    return (
        topic for topic in graph.topics.values() if action_of(topic.name) is None and not _is_of_actionlib(topic, graph)
    )


def _is_of_actionlib(topic: Topic, graph: Graph) -> bool:
    """Whether a topic is one of the five of a ROS 1 action."""
    # This also checks types, unlike Graph.is_of_action, which guards writes and may match too many. A match here
    # has no resource: a topic of another type next to an action, or with such a name, keeps its own.
    action, _, part = topic.name.rpartition("/")
    ending = _ACTIONLIB.get(part)
    return ending is not None and action in graph.actions and all(ref.name.endswith(ending) for ref in topic.types)


_STATUSES = tuple(map(Literal, (IDLE, *(status.value for status in GoalStatus))))


def _parts(action: str, schema: ActionSchema | None) -> Iterator[Property]:
    """Yield the properties below an action's name: the status of its goal and, if its type is known, the messages."""
    yield Property(
        f"{action}/{GoalPart.STATUS.value}",
        ScalarShape(Primitive("string"), Bounds(choices=_STATUSES)),
        (GoalSource(action, GoalPart.STATUS, None),),
    )
    if schema is not None:
        halves = {GoalPart.GOAL: schema.goal, GoalPart.FEEDBACK: schema.feedback, GoalPart.RESULT: schema.result}
        for part, half in halves.items():
            shape = value_shape(half, half.type.fields)
            yield Property(f"{action}/{part.value}", shape, (GoalSource(action, part, half),))


def _schemas(
    things: Iterable[RosAction | Service], kind: type[_Kind], schema_of: SchemaOf, conventions: Conventions
) -> Mapping[str, _Kind | None]:
    """Return the services, or the actions of ROS, that are in resources, with their schemas."""
    found: dict[str, _Kind | None] = {}
    for thing in things:
        if not conventions.excludes(thing.name):
            schema = schema_of(thing.type) if thing.type is not None else None
            found[thing.name] = schema if isinstance(schema, kind) else None
    return found


def _message_schema(ref: TypeRef | None, schema_of: SchemaOf) -> MessageSchema | None:
    schema = schema_of(ref) if ref is not None else None
    return schema if isinstance(schema, MessageSchema) else None


def _by_property(
    services: Mapping[str, ServiceSchema | None],
    templates: tuple[str, ...],
    made: Callable[[str, ServiceSchema], _S | None],
) -> Mapping[str, tuple[_S, ...]]:
    """Return the candidates for reading (or writing) each property, in order of preference."""
    found: dict[str, list[tuple[int, str, _S]]] = {}
    for service, schema in services.items():
        proposed = _propose_name(templates, service)
        if proposed is None or schema is None:
            continue
        name, rank = proposed
        if (source := made(service, schema)) is not None:
            found.setdefault(name, []).append((rank, service, source))
    return {name: tuple(one[2] for one in sorted(each, key=lambda one: one[:2])) for name, each in found.items()}


def _getter(service: str, schema: ServiceSchema) -> Getter | None:
    fields = value_fields(schema)
    return Getter(service, schema, fields) if fields else None


def _setter(service: str, schema: ServiceSchema) -> Setter | None:
    return Setter(service, schema) if schema.request.type.fields else None


def _property(
    name: str,
    topic: TopicSource | None,
    getters: Iterable[Getter],
    setters: Iterable[Setter],
    parameter: ParameterSource | None,
) -> Property:
    """Return the readers and writers of one property. Each must agree with the previous ones on the type of the value.

    A topic and a getter of different types are two things with one name (`/map`, an image, and `/get_map`, its file
    name). Readers of the property must know its type, so the topic keeps the name. A parameter has no type that could
    differ.
    """
    shape: ValueShape = OpenShape()
    if topic is not None and topic.schema is not None:
        shape = value_shape(topic.schema, topic.schema.type.fields)
    getter = next((one for one in getters if is_convertible(value_shape(one.schema.response, one.fields), shape)), None)
    if getter is not None and isinstance(shape, OpenShape):
        shape = value_shape(getter.schema.response, getter.fields)
    setter = next((one for one in setters if is_convertible(shape, _requested_shape(one))), None)
    if setter is not None and isinstance(shape, OpenShape):
        shape = _requested_shape(setter)
    writable = topic if topic is not None and topic.schema is not None else None
    readers: tuple[Reader | None, ...] = (topic, getter, parameter)
    writers: tuple[Writer | None, ...] = (setter, parameter, writable)
    return Property(
        name,
        shape,
        tuple(one for one in readers if one is not None),
        tuple(one for one in writers if one is not None),
    )


def _requested_shape(setter: Setter) -> ValueShape:
    request = setter.schema.request
    return value_shape(request, request.type.fields)
