"""Durable storage of the resources that clients write. The RDF dataset is an index of these records."""
