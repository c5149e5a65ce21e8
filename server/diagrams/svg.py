"""Diagrams as SVG with links, and as DOT of Graphviz. All text of the robot is escaped. No I/O."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from html import escape

from rosld.server.diagrams.diagram import Diagram, Edge, Vertex, VertexKind
from rosld.server.diagrams.layout import Layout, Point, Size, lay_out

MEDIA_TYPE = "image/svg+xml"
_CHARACTER, _PADDING = 7.3, 11.0
_HEIGHT, _LINE = 30.0, 15.0
_LONGEST = 34
_UNPRINTABLE = re.compile(r"[^\x20-\x7e\xa0-\ud7ff\uf900-\ufdcf\ufdf0-\ufffd]|[\u202a-\u202e\u2066-\u2069]")
_STYLE = """
svg { font: 13px ui-sans-serif, system-ui, "Segoe UI", Roboto, "Liberation Sans", sans-serif; color-scheme: light dark;
  --ink: #1f2629; --quiet: #5c676b; --line: #cfd3d3; --card: #ffffff; --edge: #8a9295; --accent: #0f5f66;
  --bad: #93231c; --wash: #eef3f1; }
@media (prefers-color-scheme: dark) { svg { --ink: #e2e6e4; --quiet: #9ca8ab; --line: #3c474b; --card: #1a2023;
  --edge: #6d797d; --accent: #80cac6; --bad: #f2a59d; --wash: #1e2729; background: #14191b; } }
.vertex rect { fill: var(--card); stroke: var(--edge); } .vertex.node rect { fill: var(--wash); stroke: var(--accent); }
.vertex.service rect { stroke-dasharray: 2 3; } .vertex.action rect { stroke-dasharray: 7 3; }
.vertex text { fill: var(--ink); } .vertex .words { fill: var(--quiet); font-size: 11px; }
.vertex.unheard rect { stroke: var(--line); } .vertex.unheard text { fill: var(--quiet); }
.vertex.bad rect { stroke: var(--bad); stroke-width: 2; } .vertex.bad .words { fill: var(--bad); }
.edge path { fill: none; stroke: var(--edge); } .edge.bad path { stroke: var(--bad); stroke-dasharray: 5 4; }
.arrow { fill: var(--edge); } .edge.bad .arrow { fill: var(--bad); } a { text-decoration: none; }
a:hover rect { stroke: var(--accent); stroke-width: 2; }
"""
"""Style of a separate document; on a page the page's style sheet has the same rules."""


def write_svg(diagram: Diagram, href: Callable[[str], str | None], title: str, *, alone: bool) -> str:
    """Return the drawing; `href` returns the reference of a URL. `alone`: as a document with its own style."""
    words = {each.key: _words(each) for each in diagram.vertices}
    sizes = {each.key: _size(each, words[each.key]) for each in diagram.vertices}
    layout = lay_out(sizes, ((each.source, each.target) for each in diagram.edges))
    width, height = (math.ceil(each) for each in layout.size)
    names = 'xmlns="http://www.w3.org/2000/svg" ' if alone else ""
    parts = [
        f'<svg {names}class="graph" width="{width}" height="{height}" viewBox="0 0 {width} {height}" role="group"'
        f' aria-label="{_text(title)}">',
        f"<title>{_text(title)}</title><style>{_STYLE}</style>" if alone else "",
        *(_edge(each, layout.routes[each.source, each.target]) for each in diagram.edges),
        *(_vertex(each, words[each.key], sizes[each.key], layout, href) for each in diagram.vertices),
        "</svg>",
    ]
    return "\n".join(filter(None, parts))


def label(vertex: Vertex) -> str:
    """Return the label of a vertex: its name, the end of a long one, and the number of things in it."""
    name = vertex.name if len(vertex.name) <= _LONGEST else f"…{vertex.name[1 - _LONGEST :]}"
    return name if vertex.count == 1 else f"{name} ({vertex.count} {vertex.kind.value}s)"


def _words(vertex: Vertex) -> str:
    """Return the second line: a short form of the problem, and the rate."""
    rate = f"{vertex.rate:.3g} Hz" if vertex.rate else ""
    return ", ".join(filter(None, (vertex.problem.partition(":")[0][:_LONGEST], rate)))


def _size(vertex: Vertex, words: str) -> Size:
    longest = max(len(label(vertex)), len(words) * 0.87)
    return Size(round(longest * _CHARACTER + 2 * _PADDING), _HEIGHT + (_LINE if words else 0.0))


def _vertex(vertex: Vertex, words: str, size: Size, layout: Layout, href: Callable[[str], str | None]) -> str:
    x, y = layout.corners[vertex.key]
    state = " bad" if vertex.problem else " unheard" if vertex.is_unheard else ""
    round_corner = 14 if vertex.kind is VertexKind.NODE else 3
    unheard = "no subscribers" if vertex.is_unheard else ""
    title = "; ".join(filter(None, (f"{vertex.kind.value} {label(vertex)}", vertex.problem, unheard)))
    body = (
        f'<g class="vertex {vertex.kind.value}{state}"><title>{_text(title)}</title>'
        f'<rect x="{x:.1f}" y="{y:.1f}" width="{size.width:.0f}" height="{size.height:.0f}" rx="{round_corner}"></rect>'
        f'<text x="{x + _PADDING:.1f}" y="{y + 19.5:.1f}">{_text(label(vertex))}</text>'
        + (f'<text class="words" x="{x + _PADDING:.1f}" y="{y + 35.5:.1f}">{_text(words)}</text>' if words else "")
        + "</g>"
    )
    target = href(vertex.url)
    return body if target is None else f'<a href="{escape(target)}">{body}</a>'


def _edge(edge: Edge, route: Sequence[Point]) -> str:
    """Return a curve through the points, thicker for higher rates, with an arrow at its end."""
    bad = " bad" if edge.problem else ""
    start, *rest = route
    path = [f"M{start.x:.1f} {start.y:.1f}"]
    before = start
    for point in rest:
        middle = (before.x + point.x) / 2
        path.append(f"C{middle:.1f} {before.y:.1f} {middle:.1f} {point.y:.1f} {point.x:.1f} {point.y:.1f}")
        before = point
    end, direction = route[-1], -1.0 if route[-1].x >= route[-2].x else 1.0
    tip = f"M{end.x:.1f} {end.y:.1f}l{direction * 8:.0f} -4v8z"
    title = f"<title>{_text(edge.problem)}</title>" if edge.problem else ""
    return (
        f'<g class="edge{bad}">{title}<path d="{"".join(path)}" stroke-width="{thickness(edge.rate):.1f}"></path>'
        f'<path class="arrow" d="{tip}" stroke-width="0"></path></g>'
    )


def thickness(rate: float) -> float:
    """Return the width of an edge: 1 if its rate is unknown, 5 from 1000 messages per second on."""
    return 1.0 if rate <= 0 else min(5.0, 1.5 + 3.5 * math.log10(1.0 + rate) / 3.0)


def _text(text: str) -> str:
    """Return escaped text, without characters that are invalid in XML."""
    return escape(_UNPRINTABLE.sub("�", text))


DOT_TYPE = "text/vnd.graphviz"
_DOT_SHAPES = {
    VertexKind.NODE: 'shape=box, style="rounded,filled", fillcolor="#eef3f1"',
    VertexKind.TOPIC: "shape=box",
    VertexKind.SERVICE: "shape=box, style=dotted",
    VertexKind.ACTION: "shape=box, style=dashed",
}
_DOT_BAD, _DOT_UNHEARD = 'color="#93231c", fontcolor="#93231c"', 'color="#cfd3d3", fontcolor="#5c676b"'


def write_dot(diagram: Diagram) -> str:
    """Return the digraph: vertices with kind, name and URL; edges with their problems as labels."""
    parts = (*map(_dot_vertex, diagram.vertices), *map(_dot_edge, diagram.edges))
    return "\n".join(["digraph robot {", "  rankdir=LR;", *parts, "}", ""])


def _dot_vertex(vertex: Vertex) -> str:
    line = f"{vertex.name} ({vertex.count} {vertex.kind.value}s)" if vertex.count > 1 else vertex.name
    text = "\n".join(filter(None, (line, vertex.problem)))
    state = f", {_DOT_BAD}" if vertex.problem else f", {_DOT_UNHEARD}" if vertex.is_unheard else ""
    return (
        f"  {_quote(vertex.key)} [{_DOT_SHAPES[vertex.kind]}, label={_quote(text)}, URL={_quote(vertex.url)}{state}];"
    )


def _dot_edge(edge: Edge) -> str:
    attributes = [f"penwidth={thickness(edge.rate):.1f}"]
    if edge.problem:
        attributes += [f"label={_quote(edge.problem)}", _DOT_BAD]
    return f"  {_quote(edge.source)} -> {_quote(edge.target)} [{', '.join(attributes)}];"


def _quote(text: str) -> str:
    """Return a quoted string, in which nothing is an escape sequence of DOT."""
    safe = text.encode("utf-8", "replace").decode().replace("\0", "�")
    return '"' + safe.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n") + '"'
