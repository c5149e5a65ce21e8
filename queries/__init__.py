"""Shipped SPARQL queries, each with its purpose and parameters in its leading comments.

    # The question that the query answers, in plain words.
    # @param NAME TYPE [DEFAULT] -- description

TYPE is `iri`, `string`, `integer` or `double`. A parameter without a default is required (`""` is the empty string). In
the text it is the variable `?NAME`, which may replace any term, but cannot be selected.

The default graph is the union of all named graphs without deduplication: a triple in two graphs is found twice. Hence
DISTINCT.
"""
