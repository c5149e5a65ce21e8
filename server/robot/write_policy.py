"""Write policy: the topics and parameters that may be written to, finite numbers, and the rate of publishes.

A robot's sensors are published by its nodes; another publisher would falsify them. So a topic is writable if no other
node publishes it and another node subscribes to it (or rosld itself advertised it); more needs explicit permission.
"""

from __future__ import annotations

from fnmatch import fnmatchcase

from msgspec import Struct, field

from rosld.adapters.model import Graph, Kind, Topic
from rosld.ontology.neutral_message import COMMANDS
from rosld.server.auth.rate_limit import TokenBucket

RESERVED = frozenset({"/clock", "/tf", "/tf_static", "/rosout", "/rosout_agg", "/parameter_events"})


def denied_reason(
    topic: Topic, graph: Graph, permitted: tuple[str, ...], *, needs_subscriber: bool = True
) -> str | None:
    """Return why `topic` must not be published to, in a sentence; None if it may be.

    `permitted` are the globs of --allow-publish; reserved topics must be listed by their exact name. `needs_subscriber`
    is False for a topic being published to: a subscriber that restarts does not end that.
    """
    name = topic.name
    if name in permitted:
        return type_conflict(topic)
    if is_reserved(name, graph):
        return f"{name} belongs to ROS itself; to publish there anyway, start rosld with --allow-publish {name}."
    if any(fnmatchcase(name, glob) for glob in permitted):
        return type_conflict(topic)
    others = [endpoint.node for endpoint in topic.publishers if endpoint.node != graph.own_node]
    if others:
        return (
            f"{name} is published by {', '.join(others[:3])}: it reports on the robot and does not command it. To "
            f"publish there anyway, start rosld with --allow-publish {name}."
        )
    own = any(endpoint.node == graph.own_node for endpoint in topic.publishers)
    if needs_subscriber and not own and not any(endpoint.node != graph.own_node for endpoint in topic.subscribers):
        return f"No node subscribes to {name}; to publish there anyway, start rosld with --allow-publish {name}."
    return type_conflict(topic)


def takes_finite_numbers(graph: Graph, permitted: tuple[str, ...], kind: Kind, name: str, type: str = "") -> bool:
    """Whether messages to a name are commands: all except those on a topic that another node publishes too.

    `permitted` are the globs of --allow-non-finite, `type` is the name of the message type.
    """
    if permitted and any(fnmatchcase(name, glob) for glob in permitted):
        return False
    topic = graph.topics.get(name) if kind is Kind.TOPIC else None
    if topic is None or not topic.publishers or type in COMMANDS:
        return True
    return all(each.node == graph.own_node for each in topic.publishers)


def any_number_hint(name: str) -> str:
    """Return the hint on how to allow any number, for the end of a sentence."""
    return f"start rosld with --allow-non-finite {name} to send it anyway"


def resources_only_reason(name: str) -> str:
    """Return why a name that `--resources-only` matches cannot be written to by its own URL."""
    return f"{name} can be written only through /resources/ (--resources-only), where mappings protect it."


def parameter_denied_reason(graph: Graph, name: str, *, delete: bool = False) -> str | None:
    """Return why a node's declaration prevents setting (or deleting) its parameter, in a sentence, or None."""
    parameter = graph.parameters.get(name)
    descriptor = None if parameter is None else parameter.descriptor
    if descriptor is None:
        return None
    if descriptor.read_only:
        return f"The parameter {name} is read-only: its node declares its value constant."
    if delete and descriptor.type is not None:
        return f"The parameter {name} cannot be deleted: its node declares it statically."
    return None


def type_conflict(topic: Topic) -> str | None:
    """Return why a topic has no single type, in a sentence; None if its nodes agree."""
    if len(topic.types) > 1:
        names = " and ".join(f"{ref.name} ({ref.hash})" if ref.hash else ref.name for ref in topic.types)
        return f"The nodes on {topic.name} disagree on its type: {names}."
    return None


def is_reserved(name: str, graph: Graph) -> bool:
    """Whether a topic belongs to ROS itself, or to an action."""
    return name in RESERVED or graph.is_of_action(name)


class PublishLimiter(Struct):
    """Rate limiter of publishes: at most `rate` per second and topic, in bursts of up to one second's worth."""

    rate: float
    _buckets: dict[str, TokenBucket] = field(default_factory=dict)

    def wait(self, topic: str, now: float, *, is_counted: bool = True) -> float:
        """Count a publish (if `is_counted`) and return 0.0, or return the seconds until one is allowed."""
        bucket = self._bucket(topic)
        seconds = bucket.wait(now)
        if seconds == 0.0 and is_counted:
            bucket.take(now)
        return seconds

    def count(self, topic: str, now: float) -> None:
        """Count a publish that cannot wait; the next ones wait instead, by a second's worth at most."""
        self._bucket(topic).take(now, debt=self.rate)

    def _bucket(self, topic: str) -> TokenBucket:
        found = self._buckets.get(topic)
        if found is None:
            found = self._buckets[topic] = TokenBucket(self.rate, self.rate)
        return found
