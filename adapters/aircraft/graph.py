"""The computation graph of the aircraft, as a pure function of what rosld advertises and which parameters there are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from rosld.adapters.aircraft.fly import ACTION
from rosld.adapters.aircraft.services import SERVICES
from rosld.adapters.local_topics import AdvertisedTopic
from rosld.adapters.model import Action, Endpoint, Graph, Node, Parameter, Service, Topic, TypeRef, freeze

AIRCRAFT = "/aircraft"
COCKPIT = "/cockpit"
ROSLD = "/rosld"
SPEED = "/aircraft/engine/speed"
DISPLAY = "/cockpit/display"


def aircraft_graph(
    revision: int,
    types: Mapping[str, TypeRef],
    advertised: Mapping[str, AdvertisedTopic],
    parameters: Iterable[str],
) -> Graph:
    """The graph: `types` holds the types of the aircraft's own topics, services and action by the names of these."""
    nodes = [AIRCRAFT, COCKPIT, *([ROSLD] if advertised else [])]
    return Graph(
        revision,
        own_node=ROSLD,
        nodes=freeze({name: Node(name) for name in nodes}),
        topics=freeze({name: _topic(name, types, advertised) for name in (SPEED, DISPLAY, *sorted(advertised))}),
        services=freeze({name: Service(name, types[name], (AIRCRAFT,)) for name in SERVICES}),
        actions=freeze({ACTION: Action(ACTION, types[ACTION], (AIRCRAFT,))}),
        parameters=freeze({name: Parameter(name) for name in sorted(parameters)}),
    )


def _topic(name: str, types: Mapping[str, TypeRef], advertised: Mapping[str, AdvertisedTopic]) -> Topic:
    own = advertised.get(name)
    kind = own.type if own else types[name]
    publishers = [Endpoint(AIRCRAFT, kind)] if name == SPEED else []
    if own:
        publishers.append(Endpoint(ROSLD, kind, latched=own.latched))
    subscribers = (Endpoint(COCKPIT, kind),) if name == DISPLAY else ()
    return Topic(name, (kind,), tuple(publishers), subscribers)
