"""Documents of clients: RDF sources, files and containers under `/data/` (LDP 1.0)."""
