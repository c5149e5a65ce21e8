"""Schemas of message types, requested from the adapter once and then cached."""

from __future__ import annotations

from rosld.adapters.base import Adapter
from rosld.adapters.model import ActionSchema, MessageSchema, Schema, ServiceSchema, TypeRef, UnknownType
from rosld.server.runtime.tasks import loop_time

_PATIENCE = 5.0


class Schemas:
    """The schemas of one adapter, cached by name and hash; a reference without a hash is always resolved again."""

    def __init__(self, adapter: Adapter) -> None:
        self._adapter = adapter
        self._known: dict[TypeRef, Schema] = {}
        self._named: dict[str, Schema] = {}

    @property
    def count(self) -> int:
        """Number of cached schemas, which increases with each new one."""
        return len(self._known)

    def all(self) -> list[Schema]:
        """Return the cached schemas, each once."""
        return list({id(schema): schema for schema in self._known.values()}.values())

    def find_cached(self, ref: TypeRef) -> Schema | None:
        """Return the cached schema, or None."""
        return self._known.get(ref)

    def find_cached_by_name(self, name: str) -> Schema | None:
        """Return a cached schema of this name with any hash."""
        return self._named.get(name)

    def find_similar(self, ref: TypeRef) -> Schema | None:
        """Return the cached schema of a type, or one of its name with another hash, or None."""
        return self._known.get(ref) or self._named.get(ref.name)

    def find_message(self, ref: TypeRef | None) -> MessageSchema | None:
        """Return the cached schema of a message type as `find_similar` does, or None."""
        found = None if ref is None else self.find_similar(ref)
        return found if isinstance(found, MessageSchema) else None

    def definition_of(self, ref: TypeRef) -> str:
        """Return the cached definition of a message type, or an empty string."""
        found = self.find_similar(ref)
        return found.definition if isinstance(found, MessageSchema) else ""

    def add(self, ref: TypeRef, schema: Schema) -> None:
        """Add a schema from another source, such as a recording."""
        self._known.setdefault(schema.ref, schema)
        self._named.setdefault(schema.ref.name, schema)
        self._known.setdefault(ref, schema)

    async def get(self, ref: TypeRef) -> Schema:
        """Return the schema of a type. Raises UnknownType, and Unreachable or TimedOut if the robot must be queried."""
        if (known := self._known.get(ref)) is not None:
            return known
        deadline = loop_time() + _PATIENCE
        schema = await self._adapter.schema(ref, deadline=deadline)
        self._known[schema.ref] = self._named[schema.ref.name] = schema
        if ref.hash is not None:
            self._known[ref] = schema
        return schema

    async def message(self, ref: TypeRef) -> MessageSchema:
        """Return the schema of a message type. Raises UnknownType also for a service or action type."""
        schema = await self.get(ref)
        if not isinstance(schema, MessageSchema):
            raise UnknownType(f"{ref.name} is not a message type")
        return schema

    async def service(self, ref: TypeRef) -> ServiceSchema:
        """Return the schema of a service type. Raises UnknownType also for a message or action type."""
        schema = await self.get(ref)
        if not isinstance(schema, ServiceSchema):
            raise UnknownType(f"{ref.name} is not a service type")
        return schema

    async def action(self, ref: TypeRef) -> ActionSchema:
        """Return the schema of an action type. Raises UnknownType also for a message or service type."""
        schema = await self.get(ref)
        if not isinstance(schema, ActionSchema):
            raise UnknownType(f"{ref.name} is not an action type")
        return schema
