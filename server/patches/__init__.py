"""Patches of stored resources (LDP 4.2.7): SPARQL Update, N3 Patch, JSON merge patch."""
