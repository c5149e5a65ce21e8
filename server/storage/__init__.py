"""Records: what clients have put, kept whole and durably. The RDF dataset is its index, never its only copy."""

from rosld.server.storage.base import Records
from rosld.server.storage.differences import Step
from rosld.server.storage.record import (
    NO_MEMBER,
    Blob,
    Cause,
    Changed,
    Conflict,
    Difference,
    Member,
    Membership,
    Model,
    Put,
    Record,
    Remove,
    StorageError,
    Write,
)
from rosld.server.storage.sqlite import SqliteRecords, open_records

__all__ = [
    "NO_MEMBER",
    "Blob",
    "Cause",
    "Changed",
    "Conflict",
    "Difference",
    "Member",
    "Membership",
    "Model",
    "Put",
    "Record",
    "Records",
    "Remove",
    "SqliteRecords",
    "Step",
    "StorageError",
    "Write",
    "open_records",
]
