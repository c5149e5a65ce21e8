"""The computation graph of the rover, as a pure function of what rosld advertises."""

from __future__ import annotations

from collections.abc import Mapping

from rosld.adapters.local_topics import AdvertisedTopic
from rosld.adapters.model import (
    Action,
    Choice,
    Descriptor,
    Endpoint,
    Graph,
    Node,
    Parameter,
    ParameterType,
    Range,
    Service,
    Topic,
    TypeRef,
    freeze,
)
from rosld.adapters.rover.settings import NODE, PARAMETERS, Declaration
from rosld.adapters.rover.topics import (
    CMD_VEL,
    CMD_VEL_TYPE,
    DOCK,
    DOCK_TYPE,
    LATCHED,
    NAVIGATE_TO,
    NAVIGATE_TO_TYPE,
    PERIODIC,
    ROSOUT,
    ROSOUT_TYPE,
    SET_LIGHTS,
    SET_LIGHTS_TYPE,
)

ROSLD = "/rosld"
TOPICS: Mapping[str, str] = {
    CMD_VEL: CMD_VEL_TYPE,
    ROSOUT: ROSOUT_TYPE,
    **{name: topic.type for name, topic in PERIODIC.items()},
    **{name: topic.type for name, topic in LATCHED.items()},
}
"""The types of the rover's topics."""
SERVICES: Mapping[str, str] = {SET_LIGHTS: SET_LIGHTS_TYPE, DOCK: DOCK_TYPE}
ACTIONS: Mapping[str, str] = {NAVIGATE_TO: NAVIGATE_TO_TYPE}
_TYPES: Mapping[type, ParameterType] = {
    bool: ParameterType.BOOLEAN,
    int: ParameterType.INTEGER,
    float: ParameterType.DOUBLE,
    str: ParameterType.STRING,
}


def rover_graph(revision: int, types: Mapping[str, TypeRef], advertised: Mapping[str, AdvertisedTopic]) -> Graph:
    """The graph: `types` holds the types of the rover's topics, services and action by the names of these."""
    return Graph(
        revision,
        own_node=ROSLD,
        nodes=freeze({name: Node(name) for name in (NODE, *([ROSLD] if advertised else []))}),
        topics=freeze({name: _topic(name, types, advertised) for name in (*TOPICS, *sorted(advertised))}),
        services=freeze({name: Service(name, types[name], (NODE,)) for name in SERVICES}),
        actions=freeze({name: Action(name, types[name], (NODE,)) for name in ACTIONS}),
        parameters=GRAPH_PARAMETERS,
    )


def _topic(name: str, types: Mapping[str, TypeRef], advertised: Mapping[str, AdvertisedTopic]) -> Topic:
    own = advertised.get(name)
    kind = own.type if own else types[name]
    publishers = [Endpoint(NODE, kind, latched=name in LATCHED)] if name in TOPICS and name != CMD_VEL else []
    if own:
        publishers.append(Endpoint(ROSLD, kind, latched=own.latched))
    subscribers = (Endpoint(NODE, kind),) if name == CMD_VEL else ()
    return Topic(name, (kind,), tuple(publishers), subscribers)


def _descriptor(declared: Declaration) -> Descriptor:
    limits = None
    if declared.least is not None and declared.greatest is not None:
        limits = Range(declared.least, declared.greatest)
    return Descriptor(
        _TYPES[type(declared.default)],
        declared.description,
        declared.is_read_only,
        range=limits,
        choices=tuple(Choice(value, description=words) for value, words in (declared.choices or {}).items()),
    )


GRAPH_PARAMETERS = freeze(
    {f"{NODE}/{name}": Parameter(f"{NODE}/{name}", NODE, _descriptor(each)) for name, each in PARAMETERS.items()}
)
