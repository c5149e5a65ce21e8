"""The query process, which holds the dataset and evaluates SPARQL, so that no query can block or end the server.

It is single-threaded and applies the changes of graphs that the server sends, in order. Its workers are forks that
receive the same changes: a job sees every change sent before it.
"""
