"""A recording as documents: what it is, what types it holds, and each of its messages under its own URL."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

from rosld.adapters.base import RecordedMessage, Recording
from rosld.adapters.model import MessageSchema, RosError, TypeRef
from rosld.ontology.describe import bag_document, bag_message_document, type_document
from rosld.ontology.document import Document, Envelope, LiftedMessage
from rosld.ontology.lift import Lifter, LiftSettings, lifter
from rosld.ontology.serialize import Syntax, serialize
from rosld.ontology.urls import Space

_HEADER = re.compile(rb"(?:@(?:base|prefix) [^\n]*\n)+")


class Lifting:
    """The documents of one recording; `unread` counts, by reason, the messages that could not be decoded."""

    def __init__(self, recording: Recording, space: Space, settings: LiftSettings, *, simulated_time: bool) -> None:
        self.recording = recording
        self.unread: Counter[str] = Counter()
        self._space = space
        self._settings = settings
        self._simulated_time = simulated_time
        self._readers: dict[TypeRef, tuple[MessageSchema, Lifter] | str] = {}
        self._publishers: dict[str, str | None] = {"": None}

    def descriptions(self) -> Iterator[Document]:
        """The recording with its topics, then each type that can be read."""
        yield bag_document(self.recording, self._space)
        refs = list(dict.fromkeys(topic.type for topic in self.recording.topics.values()))
        for ref in refs:
            reader = self._reader(ref)
            if not isinstance(reader, str):
                yield type_document(reader[0], self._space, tuple(other for other in refs if other.name == ref.name))

    def messages(self) -> Iterator[Document]:
        """One document a message, in recorded order; one that cannot be decoded says why."""
        for message in self.recording.messages():
            lifted = self._lifted(message)
            if isinstance(lifted, str):
                self.unread[f"{message.topic}: {lifted}"] += 1
                yield bag_message_document(self.recording, message, self._space, None, unreadable=lifted)
                continue
            document = bag_message_document(self.recording, message, self._space, lifted)
            yield replace(document, simulated_time=True) if self._simulated_time else document

    def _lifted(self, message: RecordedMessage) -> LiftedMessage | str:
        sample = message.sample
        reader = self._reader(sample.schema)
        if isinstance(reader, str):
            return reader
        schema, written = reader
        try:
            decoded = schema.codec.decode(sample.data, sample.encoding)
        except ValueError as error:
            return str(error)
        envelope = Envelope(sample.received_ns, sample.sequence, self._publisher(sample.publisher))
        return LiftedMessage("#message", written, decoded, envelope)

    def _reader(self, ref: TypeRef) -> tuple[MessageSchema, Lifter] | str:
        """How messages of a type are read and written, or why they are not."""
        found = self._readers.get(ref)
        if found is None:
            found = self._readers[ref] = self._new_reader(ref)
        return found

    def _new_reader(self, ref: TypeRef) -> tuple[MessageSchema, Lifter] | str:
        try:
            schema = self.recording.schema(ref)
            if not isinstance(schema, MessageSchema):
                return f"{ref.name} is no message type"
            return schema, lifter(schema, self._settings)
        except (RosError, ValueError) as error:
            return str(error)

    def _publisher(self, name: str) -> str | None:
        if name not in self._publishers:
            self._publishers[name] = self._space.node(name)
        return self._publishers[name]


class Writer:
    """Writes documents one after the other into one file; prefixes are declared when they are new or change."""

    def __init__(self, syntax: Syntax) -> None:
        self._syntax = syntax
        self._declared: dict[bytes, bytes] = {}

    def bytes(self, document: Document) -> bytes:
        """The document's part of the file."""
        text = serialize(document, self._syntax)
        header = _HEADER.match(text) if self._syntax in (Syntax.TURTLE, Syntax.TRIG) else None
        return text if header is None else self._new(header[0]) + text[header.end() :]

    def _new(self, header: bytes) -> bytes:
        """The lines of a header that say something new: the base always does, a prefix where it stood for another."""
        base, *prefixes = header.splitlines(keepends=True)
        declared = {line.split(b" ", 2)[1]: line for line in prefixes}
        fresh = [line for name, line in declared.items() if self._declared.get(name) != line]
        self._declared |= declared
        return base + b"".join(fresh)
