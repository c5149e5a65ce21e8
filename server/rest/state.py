"""The state of a resource at one moment, and its cached renderings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property, partial
from typing import TYPE_CHECKING, NamedTuple

import orjson
from msgspec import Struct, field
from msgspec.structs import replace

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
"""Minimum number of bytes of N-Triples of a large document: some 2,500 triples, which take 10 ms to render."""


class Rendering(NamedTuple):
    """A representation ready to be sent: its bytes and all headers that do not depend on the request."""

    body: bytes
    headers: list[tuple[bytes, bytes]]
    etag: str


class State(Struct, eq=False, dict=True):
    """The state of a resource: its RDF (created when first needed), and its plain JSON if there is a ROS value.

    `token` is the state part of its ETag; by default a digest of the RDF. `plain` returns ROS's own JSON, or raises the
    Problem that explains why there is none (406). `received_ns` is the time of receipt of the newest sample, for Age.
    `max_age`: seconds for which it may be shown without revalidation (RFC 9111 5.2.2.1); 0: always revalidate. `view`
    is the content of its page if that is more than its RDF. `scope` is the scope in which `tag` is unique, if it
    outlives this run of the server. `part` ends the variant of its ETags if it is only a part of the resource, so that
    a part guards a write like the whole. `headers` are added to every representation. `shapes` are the URLs of the
    shapes of its messages, in addition to that of its class. `is_long`: rendering takes a while, and so is done in a
    thread. `weight` is the approximate number of bytes of N-Triples, if there may be many: from `LARGE_BYTES` on,
    representations are rendered in worker processes, which receive a pickle of `describe`. A state and its renderings
    are cached until something changes.
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
    """Results of `redact`, by the key of the rights."""

    @property
    def is_large(self) -> bool:
        """Whether the document is too large for the event loop, and is rendered by a worker process."""
        return self.weight >= LARGE_BYTES

    @cached_property
    def document(self) -> Document:
        """RDF of the resource."""
        return self.describe()

    @cached_property
    def json_value(self) -> object:
        """Parsed plain JSON. Raises the Problem of `plain`."""
        assert self.plain is not None
        return orjson.loads(self.plain())

    @cached_property
    def tag(self) -> str:
        """State part of the ETag."""
        return self.token if self.token is not None else digest(serialize(self.document, Syntax.N_TRIPLES))

    def redact(
        self,
        permissions: Permissions,
        document: Callable[[], Document] | None = None,
        plain: Callable[[], bytes] | None = None,
    ) -> State:
        """Return the state without what the agent may not read; the tag is unchanged, so that it also guards writes.

        `document` and `plain` replace its own if the resource creates them for the agent from the start.
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


class MessageState(State, eq=False):
    """State with the newest message of each publisher; messages in between may have been skipped.

    `messages` are their publishers, epochs and sequence numbers.
    """

    messages: tuple[tuple[str, int, int], ...] = ()


class EndedState(State, eq=False):
    """The last state of an ended resource; `open_members` are the members of its plain JSON that may still change."""

    open_members: frozenset[str] = frozenset()


def _describe_redacted(describe: Callable[[], Document], permissions: Permissions) -> Document:
    return redact_document(describe(), permissions)


def require_memory(state: State) -> None:
    """Raise NotEnoughMemory if memory does not suffice to process a state's document."""
    if state.weight:
        PROCESS_MEMORY.require(state.weight * PER_CHARACTER, f"a document of {state.weight} bytes of N-Triples")
