"""Recorded messages lifted many at a time: each as the resource at its own URL says it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from pyoxigraph import Triple

from rosld.adapters.base import RecordedMessage, Recording
from rosld.adapters.model import UnknownType
from rosld.ontology.describe_bags import bag_message_document
from rosld.ontology.document import Document
from rosld.server.resources.messages import DecodedSample, decode, lift_sample
from rosld.server.robot.schemas import Schemas
from rosld.server.robot.session import Session


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


def record_document(session: Session, recording: Recording, one: DecodedRecord) -> Document:
    """What the resource of a recorded message says."""
    lifted = lift_sample(session.space, session.lifting, one.decoded) if one.decoded.message is not None else None
    said = bag_message_document(recording, one.message, session.space, lifted, unreadable=one.decoded.reason)
    return replace(said, simulated_time=session.graph.simulated_time)


def record_triples(session: Session, recording: Recording, records: Iterable[DecodedRecord]) -> list[Triple]:
    """The same of many. It takes a while: for a thread."""
    return [triple for one in records for triple in record_document(session, recording, one).all_triples()]
