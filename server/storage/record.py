"""A record: one resource that a client has made, as a value; and the writes that change records."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias

from pyoxigraph import NamedNode

from rosld.ontology.vocab import ldp


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
    """Pattern of the membership triples of a Direct or Indirect container (LDP 5.4, 5.5), as IRIs.

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
    """A stored resource.

    `path` is its URL without the base, encoded as in the URL (`data/rooms/kitchen`); that of a container ends in a
    slash. `triples` are the client's statements as N-Triples in their original spelling, without server-managed ones;
    for a non-RDF source they are those of its description. `version` rises with each change of the record, `listed`
    (of a container) with each change of its members; both are numbers of `Records.version`. `modified_ns` is the later
    of the two times. `member` is the IRI in the membership triples of the container it was created in: usually its own
    URL (None), or `NO_MEMBER` for none yet. `count` is the number of a container's members.
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
    """A member of a container: `number` orders members by creation, and never changes.

    `member` is that of its record: None means its own URL, `NO_MEMBER` none.
    """

    number: int
    path: str
    model: Model
    member: str | None


@dataclass(frozen=True, slots=True)
class Difference:
    """Change of a record's triples by a write, as N-Triples without blank nodes: `removed`, then `added`.

    `before` is the previous record; `times` are the creation and modification times stated by its first writer, which
    no write changes. Server-managed triples are excluded.
    """

    before: Record
    times: bytes
    removed: bytes
    added: bytes


@dataclass(frozen=True, slots=True)
class Put:
    """Creation or replacement of a record. `expected` is the version it must have; 0: it must not exist; None: any.

    A new record is listed in its container, which is the path up to its last segment and must exist. Its model never
    changes. `member` None keeps that of an existing record; everything else is replaced, so a non-RDF source that keeps
    its bytes repeats its blob. `only_if_absent` leaves an existing record unchanged. `unused` requires that no record
    of its path was ever removed: a server-assigned name is never reused (LDP 5.2.3.11). `difference` is the change, if
    it is known and small.
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
    """A failure of the disk or the database, in a sentence: nothing was done.

    `full`: there is no space left. `final`: every write is refused until the process is started again.
    """

    def __init__(self, sentence: str, *, full: bool = False, final: bool = False) -> None:
        super().__init__(sentence)
        self.full = full
        self.final = final


@dataclass(frozen=True, slots=True)
class RecordChange:
    """A path whose record, or whose list of members, changed after some version; `is_removed`: it was removed."""

    path: str
    version: int
    is_removed: bool


_DIRECT = (Model.DIRECT_CONTAINER, Model.INDIRECT_CONTAINER)


def container_of(path: str) -> str:
    """Return the path of the container a record is in: `data/` of `data/a` and of `data/a/`; empty for a root."""
    return path[: path.rfind("/", 0, -1) + 1]


def check_write(write: Write) -> None:
    """Raise ValueError for a write that is invalid in any state."""
    path = write.path
    if not path or path[0] == "/" or "//" in path:
        raise ValueError(f"{path!r} is no path of a record: it has an empty segment")
    if not isinstance(write, Put):
        return
    model = write.model
    if (path[-1] == "/") != model.is_container:
        raise ValueError(f"{path!r} cannot be a {model.value}: containers, and only they, end in a slash")
    if (write.blob is not None) != (model is Model.NON_RDF_SOURCE):
        raise ValueError(f"{path!r}: non-RDF sources, and only they, have a blob")
    if (write.membership is not None) != (model in _DIRECT):
        raise ValueError(f"{path!r}: Direct and Indirect containers, and only they, have a membership")


_PLAIN = (ldp.Resource, ldp.RDFSource)
MODEL_TYPES: Mapping[Model, tuple[NamedNode, ...]] = {
    Model.RDF_SOURCE: _PLAIN,
    Model.NON_RDF_SOURCE: (ldp.Resource, ldp.NonRDFSource),
    Model.BASIC_CONTAINER: (*_PLAIN, ldp.Container, ldp.BasicContainer),
    Model.DIRECT_CONTAINER: (*_PLAIN, ldp.Container, ldp.DirectContainer),
    Model.INDIRECT_CONTAINER: (*_PLAIN, ldp.Container, ldp.IndirectContainer),
}


def rdf_types(model: Model) -> tuple[NamedNode, ...]:
    """Return the classes that a resource of this model is said to be of in its RDF (LDP 4.3.1.2, 5.2.1.2)."""
    return MODEL_TYPES[model]


def database_error(error: sqlite3.Error) -> StorageError:
    """Return the exception that an error of SQLite is raised as."""
    words = str(error)
    if "locked" in words or "busy" in words:
        return StorageError("Another process is writing to these records: try again.")
    if is_disk_full(error):
        return StorageError(f"There is no space left to keep this: {words}.", full=True)
    return StorageError(f"The database of records failed: {words}.")


def is_disk_full(error: Exception) -> bool:
    """Whether SQLite says that there is no space left."""
    return "full" in str(error)
