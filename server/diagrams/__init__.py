"""Diagrams of the computation graph: content, layout, SVG and DOT. Pure: no HTTP, no robot."""
