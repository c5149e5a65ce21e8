"""Recorded messages lifted many at a time: each as the resource at its own URL says it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from pyoxigraph import Triple

from rosld.adapters.base import RecordedMessage, Recording
from rosld.adapters.model import UnknownType
from rosld.ontology.describe_bags import bag_message_document
from rosld.ontology.document import Document
from rosld.ontology.lift import LiftSettings
from rosld.ontology.urls import Space
from rosld.server.resources.messages import DecodedSample, decode, lift_sample
from rosld.server.robot.schemas import Schemas


@dataclass(frozen=True, slots=True, eq=False)
class DecodedRecord:
    """A recorded message, decoded as far as it can be."""

    message: RecordedMessage
    decoded: DecodedSample


async def learn_type(schemas: Schemas, recording: Recording, message: RecordedMessage) -> None:
    """Make the type of a recorded message known, as it was recorded, as far as it can be."""
    type = message.sample.schema
    if schemas.find_cached(type) is None:
        with contextlib.suppress(UnknownType):
            schemas.add(type, await asyncio.to_thread(recording.schema, type))


async def decode_records(
    schemas: Schemas, recording: Recording, messages: Iterable[RecordedMessage]
) -> Sequence[DecodedRecord]:
    """Decode recorded messages."""
    found: list[DecodedRecord] = []
    for message in messages:
        await learn_type(schemas, recording, message)
        found.append(DecodedRecord(message, await decode(schemas, message.sample)))
    return found


def record_document(
    space: Space, lifting: LiftSettings, recording: Recording, one: DecodedRecord, *, simulated_time: bool
) -> Document:
    """What the resource of a recorded message says."""
    lifted = lift_sample(space, lifting, one.decoded) if one.decoded.message is not None else None
    said = bag_message_document(recording, one.message, space, lifted, unreadable=one.decoded.reason)
    return replace(said, simulated_time=simulated_time)


def record_triples(
    space: Space,
    lifting: LiftSettings,
    recording: Recording,
    records: Iterable[DecodedRecord],
    *,
    simulated_time: bool,
) -> list[Triple]:
    """The same of many. It takes a while: for a thread."""
    describe = partial(record_document, space, lifting, recording, simulated_time=simulated_time)
    return [triple for one in records for triple in describe(one).all_triples()]
