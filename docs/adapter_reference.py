"""Writes the reference of the adapter contract: `python docs/adapter_reference.py`.

From `START` on, `docs/reference/adapter.md` follows from the docstrings and signatures in `adapters/`.
"""

from __future__ import annotations

import ast
import re
from inspect import cleandoc
from pathlib import Path

ADAPTERS = Path(__file__).parent.parent / "adapters"
PAGE = Path(__file__).parent / "reference" / "adapter.md"
START = "## Rules\n"
FIRST = ("Adapter", "Sink", "Subscription", "Watch")
_Function = ast.FunctionDef | ast.AsyncFunctionDef


def reference() -> str:
    """Return the generated part of the page."""
    base = ast.parse((ADAPTERS / "base.py").read_text("utf-8"))
    rules = (ast.get_docstring(base) or "").partition("Rules")[2].partition("\n\n")[2]
    kinds = {each.name: each for each in base.body if isinstance(each, ast.ClassDef) and each.name != "NullSink"}
    parts = [_kind(each, "##") for each in ({name: kinds[name] for name in FIRST} | kinds).values()]
    files = sorted((ADAPTERS / "model").glob("*.py"))
    models = [each for file in files for each in ast.parse(file.read_text("utf-8")).body]
    named = _named(ast.unparse(base), [each for each in models if isinstance(each, ast.ClassDef | ast.AnnAssign)])
    return "\n\n".join((f"{START}\n{rules}", *parts, "## Plain ROS", *(_kind(each, "###") for each in named))) + "\n"


def _name(node: ast.stmt) -> str:
    return node.name if isinstance(node, ast.ClassDef) else ast.unparse(getattr(node, "target", node))


def _named(text: str, nodes: list[ast.stmt]) -> list[ast.stmt]:
    """Return the classes and aliases that a text names, and those that they name."""
    found: list[ast.stmt] = []
    while more := [each for each in nodes if each not in found and re.search(rf"\b{_name(each)}\b", text)]:
        found += more
        text = "".join(map(ast.unparse, more))
    return [each for each in nodes if each in found]


def _kind(kind: ast.stmt, level: str) -> str:
    head = f"{level} {_name(kind)}"
    if not isinstance(kind, ast.ClassDef):
        return f"{head}\n\n`{ast.unparse(getattr(kind, 'value', kind))}`".replace("'", "")
    values = ", ".join(f"`{ast.unparse(each.targets[0])}`" for each in kind.body if isinstance(each, ast.Assign))
    fields = (ast.unparse(each).replace("'", '"') for each in kind.body if isinstance(each, ast.AnnAssign))
    lines = [re.sub(r"= field\(.*\)", "= ...", each) for each in fields]
    methods = [each for each in kind.body if isinstance(each, _Function) and not each.name.startswith("_")]
    made = [each for each in kind.body if isinstance(each, _Function) and each.name == "__init__"]
    lines += [_signature(each).replace("__init__", kind.name) for each in made]
    code = ["```python\n" + "\n".join(lines) + "\n```"] if lines else []
    if kind.name == "Adapter":
        notes = (" (required)" if len(each.body) == 1 else "" for each in methods)
        heads = (f"{level}# {each.name}\n\n`{_signature(each)}`" for each in methods)
        described = [f"{head}{note}\n\n{_text(each)}" for head, note, each in zip(heads, notes, methods, strict=True)]
    else:
        described = ["\n".join(f"- `{_signature(each)}`: {' '.join(_text(each).split())}" for each in methods)]
    return "\n\n".join(filter(None, [head, _text(kind), values, *code, *described]))


def _text(node: ast.ClassDef | _Function) -> str:
    return cleandoc(ast.get_docstring(node) or "")


def _signature(method: _Function) -> str:
    returned = "" if method.returns is None else f" -> {ast.unparse(method.returns)}"
    if any(ast.unparse(each) == "property" for each in method.decorator_list):
        return method.name + returned.replace(" ->", ":")
    arguments = re.sub(r"^self(, )?", "", ast.unparse(method.args)).replace("=", " = ")
    start = "async " if isinstance(method, ast.AsyncFunctionDef) else ""
    return f"{start}{method.name}({arguments}){returned.replace(' -> None', '')}"


if __name__ == "__main__":
    PAGE.write_text(PAGE.read_text("utf-8").partition(START)[0] + reference(), "utf-8")
