"""The state of a resource at one moment, and its renderings, each cached."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, NamedTuple

import orjson

from rosld.ontology.document import Document
from rosld.ontology.serialize import serialize
from rosld.ontology.syntax import Syntax
from rosld.server.auth.permissions import Permissions
from rosld.server.auth.redaction import redact_document
from rosld.server.http.conditional import digest
from rosld.server.runtime.process_memory import PER_CHARACTER, PROCESS_MEMORY

if TYPE_CHECKING:
    from rosld.server.hypermedia.views import View

LARGE_BYTES = 256 * 1024
"""Bytes of N-Triples from which a document is large: some 2,500 triples, which take 10 ms to be rendered."""


class Rendering(NamedTuple):
    """A representation ready to be sent: its bytes and all headers that do not change from request to request."""

    body: bytes
    headers: list[tuple[bytes, bytes]]
    etag: str


@dataclass(eq=False)
class State:
    """What a resource is like: its RDF (made when first needed), and its plain JSON where there is a ROS value.

    `token` is the state part of its ETag; without one it is a digest of the RDF. `plain` returns ROS's own JSON or
    raises the Problem that says why there is none (406). `received_ns` is when its newest sample was received, for Age.
    `max_age`: seconds for which it may be shown without asking again (RFC 9111 5.2.2.1); 0: ask each time.
    `view` is what its page is drawn from, where that is more than its RDF. `scope` names what `tag` is unique in, where
    that outlives this run of the server. `part` ends the variant of its ETags where it is only a part of the resource,
    so that the part guards a write as the whole does. `headers` go with every representation.
    `shapes` are the URLs of those that the messages in it conform to, beside that of its class.
    `is_long`: what it says takes a while to be written, so that a thread does it.
    `weight` is about how many bytes of N-Triples it says, where that may be many: from `LARGE_BYTES` on its
    representations are made in worker processes, to which `describe` goes as a pickle. A state is kept as long as
    nothing changes, and its renderings with it.
    """

    describe: Callable[[], Document]
    plain: Callable[[], bytes] | None = None
    token: str | None = None
    received_ns: int | None = None
    max_age: int = 0
    view: View | None = None
    scope: str | None = None
    part: str = ""
    headers: Mapping[str, str] = field(default_factory=dict)
    shapes: tuple[str, ...] = ()
    weight: int = 0
    is_long: bool = False
    renderings: dict[str, Rendering] = field(default_factory=dict)
    redactions: dict[str, State] = field(default_factory=dict)
    """What `redact` returned, by the key of the rights that it was made for."""

    @property
    def is_large(self) -> bool:
        """Whether the document is too large for the event loop, and is rendered by a worker process."""
        return self.weight >= LARGE_BYTES

    @cached_property
    def document(self) -> Document:
        """The RDF of the resource."""
        return self.describe()

    @cached_property
    def json_value(self) -> object:
        """The plain JSON, read. Raises the Problem of `plain`."""
        assert self.plain is not None
        return orjson.loads(self.plain())

    @cached_property
    def tag(self) -> str:
        """The state part of the ETag."""
        return self.token if self.token is not None else digest(serialize(self.document, Syntax.N_TRIPLES))

    def redact(
        self,
        permissions: Permissions,
        document: Callable[[], Document] | None = None,
        plain: Callable[[], bytes] | None = None,
    ) -> State:
        """Return the state without what the agent may not read. Its tag is the same, so that it guards writes as well.

        `document` and `plain` replace its own where the resource makes these for the agent from the beginning.
        """
        if self.is_large and document is None:
            # A worker process unpickles it.
            describe: Callable[[], Document] = partial(_describe_redacted, self.describe, permissions)
        else:

            def describe() -> Document:
                return redact_document(self.document if document is None else document(), permissions)

        return replace(
            self,
            describe=describe,
            plain=self.plain if plain is None else plain,
            token=self.tag,
            view=None if self.view is None else self.view.redact(permissions),
            renderings={},
            redactions={},
        )


@dataclass(eq=False)
class MessageState(State):
    """State with the newest message of each publisher; messages in between may have been passed over.

    `messages` are their publishers, epochs and sequence numbers.
    """

    messages: tuple[tuple[str, int, int], ...] = ()


@dataclass(eq=False)
class EndedState(State):
    """The last state of what has ended; `open_members` are those of its plain JSON that may still change."""

    open_members: frozenset[str] = frozenset()


def _describe_redacted(describe: Callable[[], Document], permissions: Permissions) -> Document:
    return redact_document(describe(), permissions)


def require_memory(state: State) -> None:
    """Raise NotEnoughMemory where there is none to work on what a state says."""
    if state.weight:
        PROCESS_MEMORY.require(state.weight * PER_CHARACTER, f"a document of {state.weight} bytes of N-Triples")
