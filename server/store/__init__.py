"""The RDF dataset that SPARQL is answered from, one named graph a resource, and its mirror in another store."""

from rosld.server.store.base import Edit, Function, QueryError, Results, Store
from rosld.server.store.memory import MemoryStore

__all__ = ["Edit", "Function", "MemoryStore", "QueryError", "Results", "Store"]
