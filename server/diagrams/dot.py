"""A diagram in the DOT language of Graphviz. No I/O."""

from __future__ import annotations

from rosld.server.diagrams.diagram import Diagram, Edge, Vertex, VertexKind
from rosld.server.diagrams.svg import thickness

MEDIA_TYPE = "text/vnd.graphviz"
_SHAPES = {
    VertexKind.NODE: 'shape=box, style="rounded,filled", fillcolor="#eef3f1"',
    VertexKind.TOPIC: "shape=box",
    VertexKind.SERVICE: "shape=box, style=dotted",
    VertexKind.ACTION: "shape=box, style=dashed",
}
_BAD, _UNHEARD = 'color="#93231c", fontcolor="#93231c"', 'color="#cfd3d3", fontcolor="#5c676b"'


def write_dot(diagram: Diagram) -> str:
    """Return the digraph: vertices with kind, name and URL; edges with their problems as labels."""
    lines = ["digraph robot {", "  rankdir=LR;", *map(_vertex, diagram.vertices), *map(_edge, diagram.edges), "}"]
    return "\n".join(lines) + "\n"


def _vertex(vertex: Vertex) -> str:
    line = f"{vertex.name} ({vertex.count} {vertex.kind.value}s)" if vertex.count > 1 else vertex.name
    label = "\n".join(filter(None, (line, vertex.problem)))
    state = f", {_BAD}" if vertex.problem else f", {_UNHEARD}" if vertex.is_unheard else ""
    return f"  {_quote(vertex.key)} [{_SHAPES[vertex.kind]}, label={_quote(label)}, URL={_quote(vertex.url)}{state}];"


def _edge(edge: Edge) -> str:
    attributes = [f"penwidth={thickness(edge.rate):.1f}"]
    if edge.problem:
        attributes += [f"label={_quote(edge.problem)}", _BAD]
    return f"  {_quote(edge.source)} -> {_quote(edge.target)} [{', '.join(attributes)}];"


def _quote(text: str) -> str:
    """Return a quoted string, in which nothing is an escape sequence of DOT."""
    safe = text.encode("utf-8", "replace").decode().replace("\0", "�")
    return '"' + safe.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n") + '"'
