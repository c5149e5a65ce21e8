"""HTTP as pure functions of values: header fields, negotiation, conditions, problems, and bounded bodies."""
