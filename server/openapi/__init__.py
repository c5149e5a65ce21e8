"""OpenAPI 3.1: a description, for machines, of everything that the server answers, as pure functions of values."""
