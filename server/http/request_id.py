"""Identifier of a request: that of the client (`X-Request-Id`, or W3C Trace Context 3.2), or a new one."""

from __future__ import annotations

import random
import re
from collections.abc import Mapping

from rosld.server.http.token_redaction import contains_token

FIELD = "x-request-id"
_GIVEN = re.compile(r"[A-Za-z0-9._:/+=~-]{1,128}")
_TRACEPARENT = re.compile(
    r"(?!ff)(?P<version>[0-9a-f]{2})-(?!0{32})(?P<trace>[0-9a-f]{32})-(?!0{16})[0-9a-f]{16}-[0-9a-f]{2}(?P<more>-.*)?"
)


def request_id(headers: Mapping[str, str]) -> str:
    """Return the identifier of a request with these fields (names in lower case).

    A new one has the form of a trace-id. It is not a secret, and needs no cryptographic randomness.
    """
    given = headers.get(FIELD)
    if given is not None and _GIVEN.fullmatch(given) and not contains_token(given):
        return given
    traceparent = headers.get("traceparent")
    parent = None if traceparent is None else _TRACEPARENT.fullmatch(traceparent)
    if parent is not None and not (parent["version"] == "00" and parent["more"]):
        return parent["trace"]
    return f"{random.getrandbits(128) or 1:032x}"
