"""SPARQL Update: a write of whatever the graphs it names are, planned whole before anything is done."""
