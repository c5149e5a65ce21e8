"""rosld turns robots into Linked Data."""

__version__ = "0.2.0"
