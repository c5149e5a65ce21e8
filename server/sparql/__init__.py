"""SPARQL: the protocol, analysis and evaluation of queries and updates, and the dataset that they see."""
