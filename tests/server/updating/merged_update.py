"""Updates by pyoxigraph over the merge of the graphs of USING, which is a set (SPARQL 1.1 Update, 3.1.3).

pyoxigraph itself finds a triple once per graph that contains it, so that COUNT and new blank nodes are too many.
"""

from __future__ import annotations

import re

import pyoxigraph
from pyoxigraph import NamedNode, Quad

_MERGED = NamedNode("urn:graph:merged")


def run_update(store: pyoxigraph.Store, text: str, base: str | None = None) -> None:
    """Run one operation; the graphs of its USING, if any, are first merged into one."""
    graphs = re.findall(r"USING <([^>]*)>", text)
    if graphs:
        triples = {
            quad.triple for graph in graphs for quad in store.quads_for_pattern(None, None, None, NamedNode(graph))
        }
        store.extend(Quad(*triple, _MERGED) for triple in triples)
        text = re.sub(r"(USING <[^>]*>\s*)+", "", text)
        text = re.sub(r"(USING NAMED|WHERE)", rf"USING {_MERGED} \1", text, count=1)
    store.update(text, base_iri=base)
    store.remove_graph(_MERGED)
