"""A record: one resource that a client has made, as a value; and the writes that change records."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias


class Model(Enum):
    """The interaction models of LDP 1.0; the values are local names of its vocabulary."""

    RDF_SOURCE = "RDFSource"
    NON_RDF_SOURCE = "NonRDFSource"
    BASIC_CONTAINER = "BasicContainer"
    DIRECT_CONTAINER = "DirectContainer"
    INDIRECT_CONTAINER = "IndirectContainer"

    def __init__(self, name: str) -> None:
        self.is_container = name.endswith("Container")
        """Whether resources are made in it."""


@dataclass(frozen=True, slots=True)
class Blob:
    """The bytes of a non-RDF source: the `id` under which they are kept, how many, and their exact media type."""

    id: str
    size: int
    media_type: str


@dataclass(frozen=True, slots=True)
class Membership:
    """What membership triples of a Direct or Indirect container are made of (LDP 5.4, 5.5), as IRIs.

    `relation` is ldp:hasMemberRelation, or with `inverse` ldp:isMemberOfRelation; `content` is
    ldp:insertedContentRelation, None for a Direct container.
    """

    resource: str
    relation: str
    inverse: bool = False
    content: str | None = None


NO_MEMBER = ""
"""What stands in membership triples for a member of an Indirect container that does not say yet what it is."""


@dataclass(frozen=True, slots=True)
class Record:
    """A resource that is kept.

    `path` is its URL without the base, encoded as in the URL (`data/rooms/kitchen`); that of a container ends in a
    slash. `triples` are N-Triples of what clients say of it, spelt as they spelt them, without anything that the server
    manages; for a non-RDF source they are its description's. `version` rises with each change of the record, `listed`
    (of a container) with each change of its members; both are numbers of `Records.version`. `modified_ns` is when the
    later of the two was. `member` is the IRI that stands for it in the membership triples of the container it was made
    in; None: its own URL, as it is as a rule; `NO_MEMBER`: it has no membership triple yet. `count` is how many members
    a container has.
    """

    path: str
    model: Model
    version: int
    created_ns: int
    modified_ns: int
    triples: bytes = b""
    blob: Blob | None = None
    membership: Membership | None = None
    member: str | None = None
    listed: int = 0
    count: int = 0


@dataclass(frozen=True, slots=True)
class Member:
    """A member of a container: `number` orders members by when they were made, and never changes.

    `member` is that of its record: None stands for its own URL, `NO_MEMBER` for nothing.
    """

    number: int
    path: str
    model: Model
    member: str | None


@dataclass(frozen=True, slots=True)
class Difference:
    """What a write changes of what a record says, as N-Triples without blank nodes: `removed`, then `added`.

    `before` is the record as it was; `times` is when it was created and modified as its first writer says, which no
    write changes. Nothing in it is the server's to say.
    """

    before: Record
    times: bytes
    removed: bytes
    added: bytes


@dataclass(frozen=True, slots=True)
class Put:
    """Make or replace a record. `expected` is the version it must have, 0: it must not be there, None: whatever.

    A new one is listed in its container, which is the path up to its last segment and must be there. Its model never
    changes. `member` None leaves what a record that is there has; everything else is replaced: a non-RDF source that
    keeps its bytes says so with the blob it has. `only_if_absent` leaves a record that is there as it is.
    `unused` makes it only where no record of its path was ever removed: a server that finds names never gives one
    twice (LDP 5.2.3.11). `difference` is what it changes, where that is known and little.
    """

    path: str
    model: Model
    triples: bytes = b""
    blob: Blob | None = None
    membership: Membership | None = None
    member: str | None = None
    expected: int | None = None
    only_if_absent: bool = False
    unused: bool = False
    difference: Difference | None = None


@dataclass(frozen=True, slots=True)
class Remove:
    """Remove a record; that it was there is remembered until it is made again. A container must be empty.

    `with_versions`: its former versions go, too.
    """

    path: str
    expected: int | None = None
    with_versions: bool = False


Write: TypeAlias = Put | Remove


class ConflictCause(Enum):
    """Why a write cannot be done as things are."""

    THERE = "there"
    """It is there, and was expected not to be."""
    MISSING = "missing"
    """It is not there, and was expected to be."""
    GONE = "gone"
    """It was removed."""
    CHANGED = "changed"
    """It has another version than expected."""
    MODEL = "model"
    """It has another interaction model, which never changes."""
    CONTAINER = "container"
    """Its container is not there."""
    NAME = "name"
    """A container of its name is there, or where it is a container something else of that name."""
    NOT_EMPTY = "not empty"
    """It is a container that has members."""
    ROOT = "root"
    """It is a container that is always there."""
    BLOB = "blob"
    """The bytes it refers to are not kept, or belong to another record."""


class Conflict(Exception):
    """A write that cannot be done as things are; nothing of its batch was done. `path` is whose."""

    def __init__(self, path: str, words: str, cause: ConflictCause) -> None:
        super().__init__(f"{path}: {words}")
        self.path = path
        self.words = words
        self.cause = cause


class StorageError(Exception):
    """The disk or the database failed: nothing was done, in a sentence. `full`: there is no space left."""

    def __init__(self, sentence: str, *, full: bool = False) -> None:
        super().__init__(sentence)
        self.full = full


@dataclass(frozen=True, slots=True)
class RecordChange:
    """A path whose record, or whose list of members, changed after some version; `is_removed`: it is no more."""

    path: str
    version: int
    is_removed: bool
