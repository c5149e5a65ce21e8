"""Redaction: remove from what the server says whatever the agent who asked may not read.

One file a kind of thing: RDF documents, problem details, Link fields, Thing Descriptions, JSON trees. All functions are
pure, and take the thing first and then the agent's rights. States (`rest/state.py`) and views (`hypermedia/views.py`)
redact themselves with these; the OpenAPI description is made of the operations that the agent may use
(`openapi/permitted_paths.py`), and SPARQL asks a redacted dataset (`sparql/restricted.py`).
"""
