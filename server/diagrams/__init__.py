"""Diagrams of the computation graph: what is drawn, where it stands, as SVG and as DOT. Pure: no HTTP, no robot."""
