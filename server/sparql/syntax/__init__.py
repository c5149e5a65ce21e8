"""Reading SPARQL: tokens, then one parser, whose tree says what a query needs, costs and is rewritten to."""
