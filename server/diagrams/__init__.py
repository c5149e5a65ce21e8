"""Diagrams of the computation graph: content, layout, SVG and DOT. Independent of HTTP and of robots. No I/O."""
