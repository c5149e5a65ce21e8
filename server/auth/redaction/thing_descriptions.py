"""Redaction of Thing Descriptions (WoT TD 1.1): remove what the agent may never use, and add the security schemes."""

from __future__ import annotations

from urllib.parse import urljoin

import orjson

from rosld.server.auth.permissions import Permissions

_SECURITY: dict[str, dict[str, object]] = {
    "token_sc": {"scheme": "combo", "oneOf": ["bearer_sc", "basic_sc"]},
    "bearer_sc": {"scheme": "bearer", "in": "header", "format": "opaque"},
    "basic_sc": {"scheme": "basic", "in": "header"},
}
"""WoT TD 1.1, 5.3.3: either of them."""


def redact_thing_description(data: bytes, permissions: Permissions) -> bytes:
    """Return a description with the forms that the agent may use, what has such forms, and the security it takes."""
    thing = orjson.loads(data)
    base = thing["id"]
    thing["securityDefinitions"], thing["security"] = _SECURITY, ["token_sc"]
    if permissions.is_unrestricted:
        return orjson.dumps(thing)

    def usable(forms: list[dict[str, str]]) -> list[dict[str, str]]:
        return [
            one
            for one in forms
            if permissions.may(one.get("htv:methodName", "GET"), urljoin(base, one["href"].partition("{?")[0]))
        ]

    for kind in ("properties", "actions", "events"):
        if kind not in thing:
            continue
        left = {name: {**one, "forms": usable(one["forms"])} for name, one in thing[kind].items()}
        thing[kind] = {name: one for name, one in left.items() if one["forms"]}
    if "forms" in thing:
        thing["forms"] = usable(thing["forms"])
        if not thing["forms"]:
            del thing["forms"]
    thing["links"] = [one for one in thing.get("links", ()) if permissions.may_read(urljoin(base, one["href"]))]
    return orjson.dumps(thing)
