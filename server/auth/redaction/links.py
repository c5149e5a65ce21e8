"""Redaction of the Link header field (RFC 8288): remove links to what the agent may not read."""

from __future__ import annotations

from functools import lru_cache

from rosld.server.auth.permissions import Permissions
from rosld.server.http import link


def redact_link_field(field: str, permissions: Permissions) -> str:
    """Return the value of a Link field without links to what the agent may not read, empty where none is left."""
    if permissions.is_unrestricted:
        return field
    # Where rights depend on types the answer may change from request to request.
    return _redact(field, permissions) if permissions.rights.is_typed else _cached_redaction(field, permissions)


def _redact(field: str, permissions: Permissions) -> str:
    return link.render(each for each in link.parse(field) if permissions.may_read(each.target))


_cached_redaction = lru_cache(maxsize=4096)(_redact)
