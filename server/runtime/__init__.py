"""Process-level services: memory, worker processes, clocks, signals and identifiers."""
