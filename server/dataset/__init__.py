"""RDF dataset that SPARQL queries use, with one named graph per resource, and its replication to another store."""

from rosld.server.dataset.base import Edit, Function, QueryError, Results
from rosld.server.dataset.memory_store import MemoryStore

__all__ = ["Edit", "Function", "MemoryStore", "QueryError", "Results"]
