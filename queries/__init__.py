"""Shipped SPARQL queries, each with its purpose and parameters in its leading comments.

    # What the query answers, in plain words.
    # @param NAME TYPE [DEFAULT] -- what it is

TYPE is `iri`, `string`, `integer` or `double`. A parameter without a default must be given (`""` is the empty string).
In the text it is the variable `?NAME`, which stands wherever a term may stand, and so not among what SELECT answers.

The default graph is the plain union of all named graphs: what is said in two of them is there twice. Hence DISTINCT.
"""
