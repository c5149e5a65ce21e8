"""Generator of `ontology/vocab.pyi`, which names every term for type checkers.

Run: `python tests/ontology/vocab_stub.py`.
"""

from pathlib import Path

from rosld.ontology import vocab

STUB = Path(vocab.__file__).with_suffix(".pyi")
_HEAD = """# Written by tests/ontology/vocab_stub.py.
# ruff: noqa: N801, N815
from collections.abc import Iterable, Mapping

from pyoxigraph import NamedNode

PREFIXES: Mapping[str, str]
NAMESPACES: Mapping[str, str]

def attribute(name: str) -> str: ...

class Namespace:
    iri: str
    terms: Mapping[str, NamedNode]
    def __init__(self, iri: str, names: str | Iterable[str]) -> None: ...
"""


def stub() -> str:
    """Return the text of the stub."""
    parts = [_HEAD]
    for name, space in vars(vocab).items():
        if isinstance(space, vocab.Namespace):
            terms = "".join(f"    {vocab.attribute(term)}: NamedNode\n" for term in space.terms)
            parts.append(f"class _{name}(Namespace):\n{terms}\n{name}: _{name}\n")
    return "\n".join(parts)


if __name__ == "__main__":
    STUB.write_text(stub(), "utf-8")
