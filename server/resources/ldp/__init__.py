"""What clients keep: RDF sources, files and containers under `/data/` (LDP 1.0)."""
