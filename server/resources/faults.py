"""Faults: what is or was wrong with the robot. PATCH acknowledges one, DELETE forgets one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from operator import attrgetter
from typing import ClassVar

import orjson
from pyoxigraph import NamedNode
from starlette.responses import Response

from rosld.ontology.describe_faults import FAULT, Fault, FaultState, Severity, fault_document, recording_url, source_url
from rosld.ontology.document import Document
from rosld.ontology.literals import date_time
from rosld.ontology.urls import Space
from rosld.ontology.vocab import ros
from rosld.server.html.forms import ChoiceForm, DeleteForm, Form
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import TEXT, URI, JsonSchema, json_object, nullable
from rosld.server.patches.single_change import PATCHES, SingleChange
from rosld.server.resources.base import Services
from rosld.server.resources.listings import ListedMember, ListingResource, time_cell
from rosld.server.resources.named_resource import KeptResource
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import JSON
from rosld.server.rest.path_item import PathItem, WriteMethod
from rosld.server.rest.resource import Answer
from rosld.server.rest.responses import offer_url
from rosld.server.rest.state import State
from rosld.server.robot.diagnostic_states import DiagnosticState, Level
from rosld.server.robot.faults import Faults
from rosld.server.runtime.version_cache import IdentityKey

_LEVELS = {Severity.WARNING: Level.WARN, Severity.ERROR: Level.ERROR, Severity.FATAL: Level.ERROR}
_REQUEST = {"state": FaultState.ACKNOWLEDGED.value}
_ACKNOWLEDGE = SingleChange(
    _REQUEST,
    ros.state,
    ros.FaultAcknowledged,
    'A fault can only be acknowledged: send {"state": "acknowledged"}, or set ros:state to ros:FaultAcknowledged.',
)
_PLAIN: JsonSchema = json_object(
    {
        **dict.fromkeys(("id", "kind", "label", "severity", "state", "words", "first", "last"), TEXT),
        **dict.fromkeys(("url", "offer", "source"), URI),
        "count": {"type": "integer", "minimum": 1},
    },
    {"healed": nullable(TEXT), **{name: nullable(URI) for name in ("topic", "activity", "recording")}},
)
_SENDS: JsonSchema = json_object({"state": {"type": "string", "enum": [FaultState.ACKNOWLEDGED.value]}})


class FaultResource(KeptResource[Fault]):
    """One fault of the robot."""

    kind = shape = "Fault"
    url_of = Space.fault
    store_of = attrgetter("faults")
    title_of = attrgetter("key.label")
    writes: ClassVar[frozenset[str]] = frozenset({"PATCH", "DELETE"})
    accepts: Mapping[str, Sequence[str]] = {"PATCH": (JSON, *PATCHES)}
    item = PathItem(
        "A fault of the robot",
        plain=_PLAIN,
        writes={
            "PATCH": WriteMethod("Acknowledges the fault; nothing else can be changed.", _SENDS, done=(204,)),
            "DELETE": WriteMethod("Forgets the fault, unless it is active.", done=(204,)),
        },
    )

    def gone_words(self, error: LookupError) -> str:
        return "was deleted, or replaced by later ones"

    async def state(self) -> State:
        fault = self.require()
        return self.states.get_or_make(
            self.url, IdentityKey(fault), lambda: State(lambda: self.document(fault), lambda: self._plain(fault))
        )

    def document(self, fault: Fault) -> Document:
        """Return the RDF of this version of the fault."""
        is_changeable, is_recorded = "PATCH" in self.methods(), self.services.history.is_enabled
        return fault_document(fault, self.space, is_recorded=is_recorded, is_changeable=is_changeable)

    def _plain(self, fault: Fault) -> bytes:
        key, space = fault.key, self.space
        members = {
            "state": fault.state.value,
            "severity": fault.severity.value,
            "label": key.label,
            "words": fault.words,
            "kind": key.kind.value,
            "id": self.id,
            "url": self.url,
            "offer": offer_url(self.url),
            "source": source_url(key, space),
            "count": fault.count,
            "first": date_time(0, fault.first_ns),
            "last": date_time(0, fault.last_ns),
            "healed": None if fault.healed_ns is None else date_time(0, fault.healed_ns),
            "topic": None if key.topic is None else space.topic(key.topic),
            "activity": None if fault.activity is None else space.url(fault.activity[0], fault.activity[1:]),
            "recording": recording_url(fault, space) if self.services.history.is_enabled else None,
        }
        return orjson.dumps(members)

    async def forms(self) -> Sequence[Form]:
        if "PATCH" not in self.methods():
            return ()
        if self.require().state is not FaultState.ACTIVE:
            return (DeleteForm("Forget the fault", "Forget"),)
        (name, choice), *_ = _REQUEST.items()
        return (ChoiceForm(name, (choice,), "Acknowledge the fault", method="PATCH", labels={choice: "Acknowledge"}),)

    async def patch(self, exchange: Exchange) -> Answer:
        """Acknowledge the fault: 204. Raises a 409 Problem if it is healed."""
        fault = self.require()
        _ACKNOWLEDGE.require(await exchange.body(), exchange.media_type, self.url, self.document(fault).triples)
        if self.require().is_healed:
            raise Problem(409, f"The fault {self.id} has healed already and needs no acknowledgement.")
        self.services.faults.acknowledge(self.id)
        return Response(status_code=204)

    async def delete(self, exchange: Exchange) -> Answer:
        """Forget the fault: 204. Raises a 409 Problem if it is active."""
        if self.require().state is FaultState.ACTIVE:
            raise Problem(409, f"The fault {self.id} is active: acknowledge it first.")
        self.services.faults.delete(self.id)
        return Response(status_code=204)


def faults_listing(services: Services) -> ListingResource:
    """`/faults/`: the faults that are kept, those that last first."""
    space, faults = services.space, services.faults

    def listed(fault: Fault) -> ListedMember:
        url, state = space.fault(fault.id), fault.state
        cells = (state.value, fault.severity.value, fault.words, str(fault.count), time_cell(fault.last_ns))
        outline = FAULT.triples(NamedNode(url), fault, space)
        return ListedMember(url, fault.key.label, cells, tuple(outline), state is FaultState.ACTIVE)

    columns = ("state", "severity", "words", "count", "last")
    return ListingResource(
        services, "faults", "The faults of the robot", columns, lambda: map(listed, faults.all()), faults.changes
    )


def lasting_states(faults: Faults, may_read: Callable[[str], bool], space: Space) -> tuple[DiagnosticState, ...]:
    """Return the faults that last and may be read, as states for a cockpit."""

    def state(fault: Fault) -> DiagnosticState:
        level, url, since_ns = _LEVELS[fault.severity], space.fault(fault.id), fault.last_ns
        return DiagnosticState(url, fault.key.label, "", level, fault.words, (), since_ns, level, since_ns)

    return tuple(state(each) for each in faults.all() if not each.is_healed and may_read(space.fault(each.id)))
