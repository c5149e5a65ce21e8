"""Generator of bodies of a media type that schemathesis does not know."""

from __future__ import annotations

from typing import Any

import schemathesis


@schemathesis.serializer("application/sparql-query", "application/sparql-update")
def sparql(_: Any, value: Any) -> bytes:
    """Return the text of a query, or of an update."""
    return str(value).encode("utf-8", "surrogatepass")
