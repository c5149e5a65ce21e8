"""A recording as documents: what it is, what types it holds, and each of its messages under its own URL."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from rosld.adapters.base import RecordedMessage, Recording
from rosld.adapters.model import MessageSchema, RosError, TypeRef
from rosld.ontology.describe_bags import bag_document, bag_message_document
from rosld.ontology.describe_types import type_document
from rosld.ontology.document import Document, Envelope, LiftedMessage
from rosld.ontology.lift import Lifter, LiftSettings, lifter
from rosld.ontology.urls import Space


class DescribedMessage(NamedTuple):
    """A recorded message with its lifted form, or the reason why it cannot be decoded."""

    recorded: RecordedMessage
    lifted: LiftedMessage | None
    unreadable: str | None = None


class Reader(NamedTuple):
    """The schema and the lifter of one message type."""

    schema: MessageSchema
    lifter: Lifter


class Lifting:
    """The documents of one recording; `unread` counts, by topic and reason, the messages that could not be decoded."""

    def __init__(self, recording: Recording, space: Space, settings: LiftSettings, *, simulated_time: bool) -> None:
        self.recording = recording
        self.unread: Counter[str] = Counter()
        self._space = space
        self._messages = space.bag_messages(recording.name)
        self._settings = settings
        self._simulated_time = simulated_time
        self._readers: dict[TypeRef, Reader | str] = {}
        self._publishers: dict[str, str | None] = {"": None}

    def descriptions(self) -> Iterator[Document]:
        """The recording with its topics, then each type that can be read."""
        yield bag_document(self.recording, self._space)
        refs = list(dict.fromkeys(topic.type for topic in self.recording.topics.values()))
        for ref in refs:
            reader = self._reader(ref)
            if isinstance(reader, Reader):
                yield type_document(reader.schema, self._space, [other for other in refs if other.name == ref.name])

    def messages(self) -> Iterator[DescribedMessage]:
        """Every message in recorded order."""
        for recorded in self.recording.messages():
            told = self._describe(recorded)
            if told.unreadable is not None:
                self.unread[f"{recorded.topic}: {told.unreadable}"] += 1
            yield told

    def document(self, told: DescribedMessage) -> Document:
        """The document of one message."""
        found = bag_message_document(
            self.recording, told.recorded, self._space, told.lifted, unreadable=told.unreadable
        )
        return replace(found, simulated_time=True) if self._simulated_time else found

    def document_without_payload(self, told: DescribedMessage) -> Document:
        """The document of one message without its triples: its URL, and how times are told."""
        return Document(f"{self._messages}{told.recorded.index}", (), (), self._simulated_time)

    def _describe(self, recorded: RecordedMessage) -> DescribedMessage:
        sample = recorded.sample
        reader = self._readers.get(sample.schema) or self._reader(sample.schema)
        if isinstance(reader, str):
            return DescribedMessage(recorded, None, reader)
        try:
            message = reader.schema.codec.decode(sample.data, sample.encoding)
        except ValueError as error:
            return DescribedMessage(recorded, None, str(error))
        envelope = Envelope(sample.received_ns, sample.sequence, self._publisher(sample.publisher))
        return DescribedMessage(recorded, LiftedMessage("#message", reader.lifter, message, envelope))

    def _reader(self, ref: TypeRef) -> Reader | str:
        """How messages of a type are read and written, or why they are not."""
        found = self._readers.get(ref)
        if found is None:
            found = self._readers[ref] = self._new_reader(ref)
        return found

    def _new_reader(self, ref: TypeRef) -> Reader | str:
        try:
            schema = self.recording.schema(ref)
            if not isinstance(schema, MessageSchema):
                return f"{ref.name} is no message type"
            return Reader(schema, lifter(schema, self._settings))
        except (RosError, ValueError) as error:
            return str(error)

    def _publisher(self, name: str) -> str | None:
        if name not in self._publishers:
            self._publishers[name] = self._space.node(name)
        return self._publishers[name]
