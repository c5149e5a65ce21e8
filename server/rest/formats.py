"""The media types that every resource can be read as, and the names that `?format=` has for them."""

from __future__ import annotations

from collections.abc import Mapping

from rosld.ontology.syntax import Syntax

HTML = "text/html"
JSON = "application/json"
MERGE_PATCH = "application/merge-patch+json"
SPARQL_UPDATE = "application/sparql-update"
RDF_BODIES = tuple(syntax.media_type for syntax in Syntax)
"""The media types that RDF is read from, and written as."""
VARIANTS: Mapping[str, str] = {syntax.media_type: syntax.extension for syntax in Syntax} | {JSON: "json", HTML: "html"}
FORMATS: Mapping[str, str] = {extension: media_type for media_type, extension in VARIANTS.items()} | {
    "turtle": Syntax.TURTLE.media_type,
    "rdfxml": Syntax.RDF_XML.media_type,
}
"""What `?format=` may ask for."""
OFFERS = (*RDF_BODIES, JSON, HTML)
"""What every resource can be read as, the default first. `application/json` is JSON-LD where there is no ROS value."""
