"""Checks of responses against `/openapi.json`: their status, headers, media type and JSON."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

from jsonschema import Draft202012Validator


def inlined(document: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the paths of a description with all references resolved."""
    resolved = Description(document).resolved

    def operation(found: dict[str, Any]) -> dict[str, Any]:
        parts = {**found, "responses": {status: resolved(each) for status, each in found["responses"].items()}}
        parts["parameters"] = [resolved(each) for each in found.get("parameters", ())]
        return parts | {"requestBody": resolved(found["requestBody"])} if "requestBody" in found else parts

    return {
        path: {name: operation(each) if isinstance(each, dict) else each for name, each in item.items()}
        for path, item in document["paths"].items()
    }


class Description:
    """The OpenAPI description of a server."""

    def __init__(self, document: dict[str, Any]) -> None:
        self.document = document
        self._validators: dict[str, Draft202012Validator] = {}
        self._patterns = {
            at: re.compile(re.sub(r"\\\{\w+\\\}", "[^/]+", re.sub(r"\\\{path\\\}", ".+", re.escape(at))))
            for at in sorted(document["paths"], key=lambda at: at.count("{"))
        }

    def place(self, path: str, method: str) -> str | None:
        """Return the path, or the template for it, under which an operation is described, or None."""
        for at, pattern in self._patterns.items():
            if pattern.fullmatch(path) and _described(method) in self.document["paths"][at]:
                return at
        return None

    def operation(self, at: str, method: str) -> dict[str, Any]:
        """Return the Operation Object of a described path."""
        found: dict[str, Any] = self.document["paths"][at][_described(method)]
        return found

    def disagreement(self, at: str, method: str, status: int, headers: Mapping[str, str], body: str | bytes) -> str:
        """Describe how a response deviates from the description, or return an empty text."""
        responses = self.operation(at, method)["responses"]
        if str(status) not in responses and status < 300:
            return f"{status} is not told of: {body[:300]!r}"
        told = self.resolved(responses.get(str(status), responses["default"]))
        for name, header in told.get("headers", {}).items():
            if header.get("required") and name.lower() not in headers:
                return f"{name} is missing in a {status}"
        if method == "HEAD" or not body:
            return ""
        contents = told.get("content", {"*/*": {}})
        media_type = headers.get("content-type", "").partition(";")[0]
        if media_type not in contents and "*/*" not in contents:
            return f"a {status} is {media_type}, not {list(contents)}"
        if status < 300 and media_type == "application/json":
            errors = self._validator(contents.get(media_type, {}).get("schema", {})).iter_errors(json.loads(body))
            return next((f"the JSON of a {status}: {error.message[:300]}" for error in errors), "")
        return ""

    def _validator(self, schema: dict[str, Any]) -> Draft202012Validator:
        key = json.dumps(schema)
        if key not in self._validators:
            self._validators[key] = Draft202012Validator({**schema, "components": self.document["components"]})
        return self._validators[key]

    def resolved(self, value: dict[str, Any]) -> dict[str, Any]:
        """Return the target of a reference within the description; other objects unchanged."""
        reference = value.get("$ref")
        if reference is None:
            return value
        found: Any = self.document
        for step in reference[2:].split("/"):
            found = found[step]
        assert isinstance(found, dict)
        return found


def _described(method: str) -> str:
    """Return the method whose description applies: HEAD is described by GET."""
    return "get" if method == "HEAD" else method.lower()
