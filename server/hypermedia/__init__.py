"""Levels two and three of the paper: resources by convention, arranged by mappings, with affordances by state."""
