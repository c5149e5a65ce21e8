"""SPARQL Update: an update states what graphs are to say, and each graph's resource knows how that comes about."""
