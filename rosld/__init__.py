"""rosld turns robots into Linked Data."""

__version__ = "0.1.0"
