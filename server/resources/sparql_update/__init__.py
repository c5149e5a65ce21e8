"""SPARQL Update: an update is evaluated to new contents of graphs, which are written by the resource of each graph."""
