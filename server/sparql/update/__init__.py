"""SPARQL Update: writes to the graphs that an update names, planned completely before any is carried out."""
