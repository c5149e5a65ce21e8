"""Documents of faults, active and past, of the robot."""

from __future__ import annotations

import hashlib
from enum import Enum

from msgspec import Struct
from pyoxigraph import NamedNode

from rosld.adapters.model import Ref
from rosld.ontology import kinds
from rosld.ontology.document import Document
from rosld.ontology.literals import date_time
from rosld.ontology.node_shape import NodeShape, many, one, optional
from rosld.ontology.triples import BODIES, RDF_SOURCE, affordance, forms
from rosld.ontology.urls import Space
from rosld.ontology.vocab import prov, rdfs, ros, td

_AROUND_NS = 10 * 1_000_000_000
"""Recorded time before a fault began, and after it ended, that its document links to."""


class FaultKind(Enum):
    """Kind of a fault, by what reveals it."""

    DIAGNOSTIC = "diagnostic"
    LOG = "log"
    GOAL = "goal"
    CALL = "call"
    NODE = "node"
    TOPIC = "topic"
    ROBOT = "robot"

    @property
    def lasts(self) -> bool:
        """Whether such a fault is a state, which counts again only after it was healed, and no event."""
        return self not in (FaultKind.LOG, FaultKind.GOAL, FaultKind.CALL)


class FaultState(Enum):
    """State of a fault; only an active one can be acknowledged."""

    ACTIVE = "active"
    ACKNOWLEDGED = "acknowledged"
    HEALED = "healed"


class Severity(Enum):
    """Severity of a fault."""

    WARNING = "warning"
    ERROR = "error"
    FATAL = "fatal"


class FaultKey(Struct, frozen=True):
    """Identity of a fault: its kind, its source (None: the robot), and the name of its part or the pattern of its text.

    `topic` is the topic that reports it.
    """

    kind: FaultKind
    source: Ref | None
    part: str = ""
    topic: str | None = None

    @property
    def id(self) -> str:
        """Id in URLs: the same whenever the fault occurs again, also in a later run of the server."""
        source = "" if self.source is None else self.source.kind.value
        whole = f"{self.kind.value}\0{source} {self.name}\0{self.part}".encode("utf-8", "surrogatepass")
        return hashlib.blake2b(whole, digest_size=6).hexdigest()

    @property
    def name(self) -> str:
        """Name of the source."""
        return "robot" if self.source is None else self.source.name

    @property
    def label(self) -> str:
        """The part if it has a name, else the name of the source."""
        return self.part or self.name


class Fault(Struct, frozen=True, eq=False):
    """A fault: immutable, replaced by its next state. Times are wall-clock nanoseconds.

    `activity` is the path of the goal or the call that failed last, `heard_at` the loop time of the last report.
    """

    key: FaultKey
    severity: Severity
    words: str
    first_ns: int
    last_ns: int
    heard_at: float
    count: int = 1
    activity: tuple[str, str] | None = None
    state: FaultState = FaultState.ACTIVE
    healed_ns: int | None = None

    @property
    def id(self) -> str:
        """Id in URLs."""
        return self.key.id

    @property
    def is_healed(self) -> bool:
        """Whether the fault is over."""
        return self.state is FaultState.HEALED


def source_url(key: FaultKey, space: Space) -> str:
    """Return the URL of the source of a fault."""
    if key.source is None:
        return f"{space.base}#robot"
    return space.url(f"{key.source.kind.value}s", tuple(key.name[1:].split("/")))


def recording_url(fault: Fault, space: Space) -> str:
    """Return the URL of the messages in the history around the last occurrence of a fault."""
    begin = date_time(0, max(0, fault.last_ns - _AROUND_NS))
    end = date_time(0, (fault.healed_ns or fault.last_ns) + _AROUND_NS)
    return f"{space.bag_messages('history')}?from={begin}&to={end}"


FAULT = NodeShape[Fault]("Fault", "a fault of the robot", ros.Fault, is_listed=True).with_properties(
    one(rdfs.label, kinds.TEXT, lambda fault: fault.key.label),
    one(ros.faultKind, kinds.TEXT, lambda fault: fault.key.kind.value),
    one(ros.faultOf, kinds.link(lambda space, key: source_url(key, space)), lambda fault: fault.key),
    optional(ros.reportedOn, kinds.TOPIC, lambda fault: fault.key.topic),
    one(ros.severity, kinds.TEXT, lambda fault: fault.severity.value),
    one(ros.words, kinds.TEXT, lambda fault: fault.words),
    one(ros.state, kinds.STATE, lambda fault: ros.terms[f"Fault{fault.state.value.capitalize()}"]),
    one(ros.occurrences, kinds.COUNT, lambda fault: fault.count),
    one(prov.startedAtTime, kinds.DATE_TIME, lambda fault: fault.first_ns),
    one(ros.lastOccurred, kinds.DATE_TIME, lambda fault: fault.last_ns),
    optional(prov.endedAtTime, kinds.DATE_TIME, lambda fault: fault.healed_ns),
    optional(prov.wasInformedBy, kinds.link(lambda space, path: space.url(path[0], path[1:])), lambda f: f.activity),
    many(td.hasActionAffordance, kinds.ACTION_AFFORDANCE),
)


def fault_document(fault: Fault, space: Space, *, is_recorded: bool, is_changeable: bool) -> Document:
    """Return the document of a fault, with a link to the history around it and a form to acknowledge it."""
    url = space.fault(fault.id)
    subject = NamedNode(url)
    recording = NamedNode(recording_url(fault, space)) if is_recorded else None
    triples = FAULT.triples(subject, fault, space, *RDF_SOURCE, (rdfs.seeAlso, recording))
    if is_changeable and fault.state is FaultState.ACTIVE:
        triples += affordance(subject, "acknowledge", td.hasActionAffordance, td.ActionAffordance)
        triples += forms(NamedNode(f"{url}#acknowledge"), "patch", "PATCH", td.invokeAction, url, BODIES[:1])
    return Document(url, tuple(triples))
