"""Bodies of a media type that schemathesis cannot write by itself."""

from __future__ import annotations

from typing import Any

import schemathesis


@schemathesis.serializer("application/sparql-query", "application/sparql-update")
def sparql(_: Any, value: Any) -> bytes:
    """The text of a query, or of an update."""
    return str(value).encode("utf-8", "surrogatepass")
