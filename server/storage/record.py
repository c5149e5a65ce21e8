"""A record: one resource that a client has created, as a value; the writes that change records, and caches of both."""

from __future__ import annotations

import sqlite3
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from enum import Enum
from typing import NamedTuple, TypeAlias

from msgspec import Struct
from msgspec.structs import replace
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
        """Whether resources can be created in it."""


class Blob(Struct, frozen=True):
    """The bytes of a non-RDF source: `id` in the blob storage, size in bytes, and the exact media type."""

    id: str
    size: int
    media_type: str


class Membership(Struct, frozen=True):
    """Pattern of the membership triples of a Direct or Indirect container (LDP 5.4, 5.5), as IRIs.

    `relation` is ldp:hasMemberRelation, or with `inverse` ldp:isMemberOfRelation; `content` is
    ldp:insertedContentRelation, None for a Direct container.
    """

    resource: str
    relation: str
    inverse: bool = False
    content: str | None = None


NO_MEMBER = ""
"""Member IRI of a member of an Indirect container that has not stated its member yet."""


class Record(Struct, frozen=True):
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


class Member(Struct, frozen=True):
    """A member of a container. `number` orders members by creation, and never changes.

    `member` is that of its record: None means its own URL, `NO_MEMBER` none.
    """

    number: int
    path: str
    model: Model
    member: str | None


class Difference(Struct, frozen=True):
    """Change of a record's triples by a write, as N-Triples without blank nodes: `removed`, then `added`.

    `before` is the previous record; `times` are the creation and modification times stated by its first writer, which
    no write changes. Server-managed triples are excluded.
    """

    before: Record
    times: bytes
    removed: bytes
    added: bytes


class Put(Struct, frozen=True):
    """Creation or replacement of a record. `expected` is its current version, 0 if it must not exist, None for any.

    A new record is listed in its container, which is the path up to its last segment and must exist. Its model never
    changes. `member` None leaves that of an existing record unchanged; everything else is replaced, so repeat the blob
    of a non-RDF source to keep its bytes. `only_if_absent` leaves an existing record unchanged. `unused` requires that
    no record of its path was ever removed: a server-assigned name is never reused (LDP 5.2.3.11). `difference` is the
    change, if it is known and small.
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


class Remove(Struct, frozen=True):
    """Removal of a record, which leaves a tombstone until the path is created again. A container must be empty.

    `with_versions` deletes its former versions, too.
    """

    path: str
    expected: int | None = None
    with_versions: bool = False


Write: TypeAlias = Put | Remove


class ConflictCause(Enum):
    """Reason why a write conflicts with the current state."""

    THERE = "there"
    """The record exists, but the write expects none."""
    MISSING = "missing"
    """The record does not exist, but the write expects it."""
    GONE = "gone"
    """The record was removed."""
    CHANGED = "changed"
    """The record has another version than the write expects."""
    MODEL = "model"
    """The record has another interaction model, which never changes."""
    CONTAINER = "container"
    """The container of the record does not exist."""
    NAME = "name"
    """The same name exists as the other kind (container or not)."""
    NOT_EMPTY = "not empty"
    """The container has members."""
    ROOT = "root"
    """The container always exists."""
    BLOB = "blob"
    """The blob does not exist, or belongs to another record."""


class Conflict(Exception):
    """A write that conflicts with the current state of `path`. None of the writes of its batch is done."""

    def __init__(self, path: str, words: str, cause: ConflictCause) -> None:
        super().__init__(f"{path}: {words}")
        self.path = path
        self.words = words
        self.cause = cause


class StorageError(Exception):
    """A failure of the disk or the database, as a sentence. Nothing was written.

    `full`: the disk is full. `final`: every later write fails until the process is restarted.
    """

    def __init__(self, sentence: str, *, full: bool = False, final: bool = False) -> None:
        super().__init__(sentence)
        self.full = full
        self.final = final


class RecordChange(Struct, frozen=True):
    """A path whose record or list of members has changed; `is_removed`: the record was removed."""

    path: str
    version: int
    is_removed: bool


_DIRECT = (Model.DIRECT_CONTAINER, Model.INDIRECT_CONTAINER)


def container_of(path: str) -> str:
    """Return the path of a record's container: `data/` for `data/a` and for `data/a/`; empty for a root."""
    return path[: path.rfind("/", 0, -1) + 1]


def check_write(write: Write) -> None:
    """Raise ValueError for a write that is invalid in any state."""
    path = write.path
    if not path or path[0] == "/" or "//" in path:
        raise ValueError(f"{path!r} is not a valid record path: it has an empty segment")
    if not isinstance(write, Put):
        return
    model = write.model
    if (path[-1] == "/") != model.is_container:
        raise ValueError(f"{path!r} cannot be a {model.value}: only containers end in a slash")
    if (write.blob is not None) != (model is Model.NON_RDF_SOURCE):
        raise ValueError(f"{path!r}: only non-RDF sources have a blob")
    if (write.membership is not None) != (model in _DIRECT):
        raise ValueError(f"{path!r}: only Direct and Indirect Containers have a membership")


_PLAIN = (ldp.Resource, ldp.RDFSource)
MODEL_TYPES: Mapping[Model, tuple[NamedNode, ...]] = {
    Model.RDF_SOURCE: _PLAIN,
    Model.NON_RDF_SOURCE: (ldp.Resource, ldp.NonRDFSource),
    Model.BASIC_CONTAINER: (*_PLAIN, ldp.Container, ldp.BasicContainer),
    Model.DIRECT_CONTAINER: (*_PLAIN, ldp.Container, ldp.DirectContainer),
    Model.INDIRECT_CONTAINER: (*_PLAIN, ldp.Container, ldp.IndirectContainer),
}


def rdf_types(model: Model) -> tuple[NamedNode, ...]:
    """Return the classes that a resource of this model has in its RDF (LDP 4.3.1.2, 5.2.1.2)."""
    return MODEL_TYPES[model]


def database_error(error: sqlite3.Error) -> StorageError:
    """Return the StorageError for an error of SQLite."""
    words = str(error)
    if "locked" in words or "busy" in words:
        return StorageError("Another process is writing to these records: try again.")
    if is_disk_full(error):
        return StorageError(f"There is no space left to store this: {words}.", full=True)
    return StorageError(f"The database of records failed: {words}.")


def is_disk_full(error: Exception) -> bool:
    """Whether SQLite reports that the disk is full."""
    return "full" in str(error)


MAX_WEIGHT = 64 * 1024 * 1024
_EACH = 1024
"""Approximate bytes of a record without its triples."""


class RecordCache:
    """Cache of records by path, which returns the same object until it is dropped or evicted."""

    __slots__ = ("_records", "_weight")

    def __init__(self) -> None:
        self._records: OrderedDict[str, Record] = OrderedDict()
        self._weight = 0

    def get(self, path: str) -> Record | None:
        """Return a cached record, or None."""
        records = self._records
        found = records.get(path)
        if found is not None:
            records.move_to_end(path)
        return found

    def peek(self, path: str) -> Record | None:
        """Return a cached record, or None, from any thread; does not defer its eviction."""
        return self._records.get(path)

    def put(self, record: Record) -> None:
        """Add a record, and evict the least recently used ones above the limit."""
        self.drop(record.path)
        self._records[record.path] = record
        self._weight += _EACH + len(record.triples)
        while self._weight > MAX_WEIGHT:
            self._weight -= _EACH + len(self._records.popitem(last=False)[1].triples)

    def drop(self, path: str) -> None:
        """Remove a record."""
        old = self._records.pop(path, None)
        if old is not None:
            self._weight -= _EACH + len(old.triples)

    def clear(self) -> None:
        """Remove all records."""
        self._records.clear()
        self._weight = 0


MAX_BYTES = 16 * 1024
"""Maximum bytes of N-Triples in the difference of one write; larger differences are not stored."""
_WRITES = 64
"""Maximum number of writes per record, and of records, whose differences are stored."""


class RecordWrite(NamedTuple):
    """One write of a record: the record before and after (client statements reduced to times), and the difference."""

    before: Record
    after: Record
    difference: Difference


class RecentWrites:
    """Differences of the latest writes, by record."""

    def __init__(self) -> None:
        self._steps: OrderedDict[str, list[RecordWrite]] = OrderedDict()

    def add(self, put: Put, record: Record) -> None:
        """Add the difference of a write that produced this record."""
        difference = put.difference
        if difference is None or put.expected != difference.before.version:
            self._steps.pop(record.path, None)
            return
        before, after = (replace(each, triples=difference.times) for each in (difference.before, record))
        steps = self._steps.setdefault(record.path, [])
        if steps and steps[-1].after.version != before.version:
            steps.clear()
        steps.append(RecordWrite(before, after, difference))
        del steps[:-_WRITES]
        self._steps.move_to_end(record.path)
        if len(self._steps) > _WRITES:
            self._steps.popitem(last=False)

    def since(self, record: Record, after: int) -> Sequence[RecordWrite] | None:
        """Return the writes that led from a version to this record, or None if they are unknown."""
        steps = [each for each in self._steps.get(record.path, ()) if each.after.version > after]
        if not steps or steps[0].before.version > after or steps[-1].after.version != record.version:
            return None
        return steps

    def clear(self) -> None:
        """Remove all differences."""
        self._steps.clear()
