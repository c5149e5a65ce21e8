"""The query process: it holds the dataset and evaluates SPARQL, so that no query can block or end the server.

The query process has one thread and makes the changes of graphs that the server sends, in their order. Its workers are
forks that receive the same changes: a job sees every change that was sent before it.
"""
