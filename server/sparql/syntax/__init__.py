"""Parsing of SPARQL: tokens, and one parser whose tree serves analysis, limits and rewriting."""
