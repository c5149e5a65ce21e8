"""Records: what clients have put, kept whole and durably. The RDF dataset is its index, never its only copy."""

from rosld.server.storage.base import Records
from rosld.server.storage.recent_writes import RecordWrite
from rosld.server.storage.record import (
    NO_MEMBER,
    Blob,
    Conflict,
    ConflictCause,
    Difference,
    Member,
    Membership,
    Model,
    Put,
    Record,
    RecordChange,
    Remove,
    StorageError,
    Write,
)
from rosld.server.storage.sqlite import SqliteRecords, open_records

__all__ = [
    "NO_MEMBER",
    "Blob",
    "Conflict",
    "ConflictCause",
    "Difference",
    "Member",
    "Membership",
    "Model",
    "Put",
    "Record",
    "RecordChange",
    "RecordWrite",
    "Records",
    "Remove",
    "SqliteRecords",
    "StorageError",
    "Write",
    "open_records",
]
