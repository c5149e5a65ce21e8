"""Media types that every resource can be read as, and their names in `?format=`."""

from __future__ import annotations

from collections.abc import Mapping

from rosld.ontology.syntax import Syntax

HTML = "text/html"
JSON = "application/json"
MERGE_PATCH = "application/merge-patch+json"
SPARQL_UPDATE = "application/sparql-update"
RDF_BODIES = tuple(syntax.media_type for syntax in Syntax)
"""Media types of RDF, for reading and writing."""
VARIANTS: Mapping[str, str] = {syntax.media_type: syntax.extension for syntax in Syntax} | {JSON: "json", HTML: "html"}
FORMATS: Mapping[str, str] = {extension: media_type for media_type, extension in VARIANTS.items()} | {
    "turtle": Syntax.TURTLE.media_type,
    "rdfxml": Syntax.RDF_XML.media_type,
}
"""Media types by their names in `?format=`."""
OFFERS = (*RDF_BODIES, JSON, HTML)
"""Media types of every resource, the default first. `application/json` is JSON-LD if there is no ROS value."""
OFFER_TYPE = "application/vnd.rosld.offer+json"
"""Media type of offers."""
CSV = "text/csv"
COLUMNS: Mapping[str, str] = {
    "parquet": "application/vnd.apache.parquet",
    "arrow": "application/vnd.apache.arrow.stream",
}
"""Media types of tables with typed columns, by their names in `?format=`."""
TABLES: Mapping[str, str] = {**COLUMNS, "csv": CSV}
"""Media types of tables, by their names in `?format=`."""
