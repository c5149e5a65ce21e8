"""OpenAPI 3.1 description of everything that the server answers, as pure functions of values."""
