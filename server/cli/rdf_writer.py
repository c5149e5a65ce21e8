"""A recording as documents (of itself, its types, and each message), and their writers."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple, Protocol

from msgspec.structs import replace

from rosld.adapters.base import MessageFilter, RecordedMessage, Recording
from rosld.adapters.model import MessageSchema, RosError, TypeRef
from rosld.ontology.describe_bags import BagView, bag_document, bag_message_document
from rosld.ontology.describe_types import type_document
from rosld.ontology.document import Document, Envelope, LiftedMessage
from rosld.ontology.lift import Lifter, LiftSettings, lifter
from rosld.ontology.literals import date_time
from rosld.ontology.serialize import serialize_named
from rosld.ontology.syntax import Syntax
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


_PAGE = 1000
"""Number of messages read at once."""


class Lifting:
    """The documents of one recording.

    `selected` counts messages, `unread` by topic and reason those that could not be decoded.
    """

    def __init__(self, recording: Recording, space: Space, settings: LiftSettings, *, simulated_time: bool) -> None:
        self.recording = recording
        self.selected = 0
        self.unread: Counter[str] = Counter()
        self._space = space
        self._messages = space.bag_messages(recording.name)
        self._settings = settings
        self._simulated_time = simulated_time
        self._readers: dict[TypeRef, Reader | str] = {}
        self._publishers: dict[str, str | None] = {"": None}

    def descriptions(self) -> Iterator[Document]:
        """Yield the document of the recording with its topics, then that of each readable type."""
        yield bag_document(BagView(self.recording), self._space)
        refs = list(dict.fromkeys(topic.type for topic in self.recording.topics.values()))
        for ref in refs:
            reader = self._reader(ref)
            if isinstance(reader, Reader):
                yield type_document(reader.schema, self._space, [other for other in refs if other.name == ref.name])

    def messages(self, criteria: MessageFilter = MessageFilter()) -> Iterator[DescribedMessage]:  # noqa: B008
        """Yield the messages that match a filter, in recorded order."""
        start: int | None = criteria.start
        while start is not None:
            page = self.recording.select(replace(criteria, start=start), _PAGE)
            start = page.next
            self.selected += len(page.messages)
            for recorded in page.messages:
                described = self._describe(recorded)
                if described.unreadable is not None:
                    self.unread[f"{recorded.topic}: {described.unreadable}"] += 1
                yield described

    def document(self, described: DescribedMessage) -> Document:
        """Return the document of one message."""
        found = bag_message_document(
            self.recording, described.recorded, self._space, described.lifted, unreadable=described.unreadable
        )
        return replace(found, simulated_time=True) if self._simulated_time else found

    def document_without_payload(self, described: DescribedMessage) -> Document:
        """Return the document of one message without triples: its URL, and whether time is simulated."""
        return Document(f"{self._messages}{described.recorded.index}", (), (), self._simulated_time)

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
        return DescribedMessage(
            recorded, LiftedMessage("#message", reader.lifter, message, envelope, frames=self._space.frames)
        )

    def _reader(self, ref: TypeRef) -> Reader | str:
        """Return the schema and lifter of a type, or why its messages are unreadable."""
        found = self._readers.get(ref)
        if found is None:
            found = self._readers[ref] = self._new_reader(ref)
        return found

    def _new_reader(self, ref: TypeRef) -> Reader | str:
        try:
            schema = self.recording.schema(ref)
            if not isinstance(schema, MessageSchema):
                return f"{ref.name} is not a message type"
            return Reader(schema, lifter(schema, self._settings))
        except (RosError, ValueError) as error:
            return str(error)

    def _publisher(self, name: str) -> str | None:
        if name not in self._publishers:
            self._publishers[name] = self._space.node(name)
        return self._publishers[name]


_HEADER = re.compile(rb"(?:@(?:base|prefix) [^\n]*\n)+")
_PLACE = 8_172_635_445_362_718
_PLACE_NS = 7_263_544_536_271_829_123
"""Placeholders of a message's index and time in a template: numbers that do not occur elsewhere."""
_INDEX = b"%d" % _PLACE
_RECEIVED = date_time(0, _PLACE_NS).encode()
_PROOFS = 3
"""Number of messages of each stream that are described in full, to verify the template."""


class Writer(Protocol):
    """Writer of the parts of one file, each as bytes to append."""

    def document(self, document: Document) -> bytes:
        """Return the bytes of a document. Raises CannotCarry as `serialize` does."""
        ...

    def message(self, described: DescribedMessage) -> bytes:
        """Return the document of one recorded message."""
        ...


def writer(syntax: Syntax, lifting: Lifting) -> Writer:
    """Return the writer of a syntax."""
    return Paragraphs(syntax, lifting) if syntax in (Syntax.TURTLE, Syntax.TRIG) else Lines(syntax, lifting)


class Paragraphs:
    """Writer of Turtle and TriG; a prefix is declared when it is new or changes its meaning."""

    def __init__(self, syntax: Syntax, lifting: Lifting) -> None:
        self._syntax = syntax
        self._lifting = lifting
        self._declared: dict[bytes, bytes] = {}

    def document(self, document: Document) -> bytes:
        """Return the document, without the prefixes that the file has already declared."""
        text = serialize_named(document, self._syntax)
        header = _HEADER.match(text)
        return text if header is None else self._new(header[0]) + text[header.end() :]

    def message(self, described: DescribedMessage) -> bytes:
        """Return the document of one recorded message."""
        return self.document(self._lifting.document(described))

    def _new(self, header: bytes) -> bytes:
        """Return the new lines of a header; the base is always included."""
        base, *prefixes = header.splitlines(keepends=True)
        declared = {line.split(b" ", 2)[1]: line for line in prefixes}
        fresh = [line for name, line in declared.items() if self._declared.get(name) != line]
        self._declared |= declared
        return base + b"".join(fresh)


class Template:
    """Template of a stream's message descriptions, with placeholders for index and time.

    The first few messages are also described in full. If one of them differs otherwise, all are.
    """

    def __init__(self, text: bytes) -> None:
        self._text = text
        self._proofs = 0
        self._holds = True

    def text(self, recorded: RecordedMessage) -> bytes:
        """Return the description of a message."""
        received = date_time(0, recorded.sample.received_ns)
        return self._text.replace(_INDEX, b"%d" % recorded.index).replace(_RECEIVED, received.encode())

    def verify(self, recorded: RecordedMessage, described: bytes) -> None:
        """Compare the template with a full description."""
        self._proofs += 1
        self._holds = self._holds and self.text(recorded) == described

    @property
    def is_verified(self) -> bool:
        """Whether the template is correct, and has been compared often enough."""
        return self._holds and self._proofs >= _PROOFS

    @property
    def is_unverified(self) -> bool:
        """Whether further comparisons are needed."""
        return self._holds and self._proofs < _PROOFS


class Lines:
    """Writer of N-Triples and N-Quads."""

    def __init__(self, syntax: Syntax, lifting: Lifting) -> None:
        self._syntax = syntax
        self._lifting = lifting
        self._templates: dict[tuple[str, str, TypeRef], Template] = {}

    def document(self, document: Document) -> bytes:
        """Return the document with one triple or quad per line."""
        return serialize_named(document, self._syntax)

    def message(self, described: DescribedMessage) -> bytes:
        """Return the lines of one message: its description by the stream's template, its values by its lifter."""
        if described.lifted is None:
            return self.document(self._lifting.document(described))
        recorded = described.recorded
        key = (recorded.topic, recorded.sample.publisher, recorded.sample.schema)
        template = self._templates.get(key)
        if template is None:
            template = self._templates[key] = self._template(described)
        if not template.is_verified:
            return self._in_full(described, template)
        bare = self._lifting.document_without_payload(described)
        end = f" <{bare.url}> .\n" if self._syntax.datasets else " .\n"
        return template.text(recorded) + described.lifted.text(bare, "ntriples", end).encode()

    def _in_full(self, described: DescribedMessage, template: Template) -> bytes:
        document = self._lifting.document(described)
        if template.is_unverified:
            template.verify(described.recorded, self._description(document))
        return self.document(document)

    def _template(self, described: DescribedMessage) -> Template:
        sample = described.recorded.sample._replace(received_ns=_PLACE_NS)
        placed = replace(described.recorded, index=_PLACE, sample=sample)
        return Template(self._description(self._lifting.document(described._replace(recorded=placed))))

    def _description(self, document: Document) -> bytes:
        return self.document(replace(document, messages=()))
