"""Records: what clients have put, kept whole and durably. The RDF dataset is its index, never its only copy."""

from rosld.server.records.record import (
    Blob,
    Changed,
    Conflict,
    Member,
    Membership,
    Model,
    Put,
    Record,
    Remove,
    Write,
)

__all__ = ["Blob", "Changed", "Conflict", "Member", "Membership", "Model", "Put", "Record", "Remove", "Write"]
