"""Redaction of JSON trees whose members are resources of their own: remove the members that the agent may not read."""

from __future__ import annotations

import json

from rosld.ontology.urls import encode_segment
from rosld.server.auth.permissions import Permissions


def redact_tree(data: bytes, url: str, permissions: Permissions) -> bytes:
    """Return the JSON object at a container's URL without the members, at any depth, whose URLs may not be read."""

    def redact(value: object, at: str) -> object:
        if not isinstance(value, dict):
            return value
        ends = {key: encode_segment(key) + ("/" if isinstance(inner, dict) else "") for key, inner in value.items()}
        return {key: redact(value[key], at + end) for key, end in ends.items() if permissions.may_read(at + end)}

    return json.dumps(redact(json.loads(data), url), ensure_ascii=False, separators=(",", ":")).encode()
