"""The RDF dataset that SPARQL is answered from, one named graph a resource, and its replica in another store."""

from rosld.server.dataset.base import Edit, Function, QueryError, Results
from rosld.server.dataset.memory_store import MemoryStore

__all__ = ["Edit", "Function", "MemoryStore", "QueryError", "Results"]
