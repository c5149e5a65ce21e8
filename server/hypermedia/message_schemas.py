"""Collector of message schemas, for a description that states each once and refers to it by name."""

from __future__ import annotations

import re
from collections.abc import Callable

from rosld.adapters.model import ActionSchema, MessageSchema, Schema, ServiceSchema, TypeRef
from rosld.ontology.lift import LiftSettings
from rosld.server.hypermedia import json_schema
from rosld.server.hypermedia.data_schema import DataSchema, message_schema
from rosld.server.hypermedia.json_schema import OBJECT

_NOT_IN_A_KEY = re.compile(r"[^A-Za-z0-9._-]")


class MessageSchemas:
    """Finds types and collects the schemas that were referred to. `find` tells of a type if it is at hand.

    A type that is not at hand is None, and its messages are objects of which nothing more is said.
    """

    def __init__(self, find: Callable[[TypeRef], Schema | None], lifting: LiftSettings) -> None:
        self.lifting = lifting
        self.by_key: dict[str, DataSchema] = {}
        """The schemas that `#/components/schemas/KEY` refers to."""
        self._find = find
        self._keys: dict[TypeRef, str] = {}

    def message(self, ref: TypeRef | None) -> MessageSchema | None:
        """A message type."""
        found = None if ref is None else self._find(ref)
        return found if isinstance(found, MessageSchema) else None

    def service(self, ref: TypeRef | None) -> ServiceSchema | None:
        """A service type."""
        found = None if ref is None else self._find(ref)
        return found if isinstance(found, ServiceSchema) else None

    def action(self, ref: TypeRef | None) -> ActionSchema | None:
        """An action type."""
        found = None if ref is None else self._find(ref)
        return found if isinstance(found, ActionSchema) else None

    def read(self, schema: MessageSchema | None) -> DataSchema:
        """What a message is when it is read: a reference to its schema."""
        if schema is None:
            return OBJECT
        key = self._key(schema.ref)
        return self._shared(key, lambda: json_schema.read_schema(message_schema(schema, self.lifting)))

    def write(self, schema: MessageSchema | None) -> DataSchema:
        """What a message may be when it is sent, which is another schema: what is left out has its default."""
        if schema is None:
            return OBJECT
        key = f"{self._key(schema.ref)}.sent"
        return self._shared(key, lambda: json_schema.write_schema(message_schema(schema, self.lifting, sent=True)))

    def _shared(self, key: str, make: Callable[[], DataSchema]) -> DataSchema:
        if key not in self.by_key:
            self.by_key[key] = make()
        return {"$ref": f"#/components/schemas/{key}"}

    def _key(self, ref: TypeRef) -> str:
        """The name of the schema of a type; variants of one type have their hash in it."""
        key = self._keys.get(ref)
        if key is None:
            key = _NOT_IN_A_KEY.sub(".", ref.name)
            if key in self._keys.values():
                key = f"{key}.{_NOT_IN_A_KEY.sub('.', ref.hash or '')}.{len(self._keys)}"
            self._keys[ref] = key
        return key
