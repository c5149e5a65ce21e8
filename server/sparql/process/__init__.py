"""The query process: it holds the dataset and evaluates SPARQL, so that no query can block or end the server.

It has one thread. What the server sends it (changes of graphs, work, cancellations) is carried out in that order, so
work sees every change that was sent before it. Work that may take long is done in a fork.
"""
