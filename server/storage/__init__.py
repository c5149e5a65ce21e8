"""Records: what clients have put, kept whole and durably. The RDF dataset is its index, never its only copy."""
