"""Small faults at random places of the product, and how many of them the tests notice.

    python -m tests.mutants record -n 3     # run all tests; which of them come by a fault's place goes to .mutants/
    python -m tests.mutants                 # make 80 faults one by one, run the tests of each
    python -m tests.mutants --tree OTHER    # the same faults in another checkout, which has a .mutants/ of its own

A place is chosen by the hash of its seed, file and line, not by its position: the same seed chooses the same places in
two versions of the product, except where the lines themselves differ.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

PACKAGES = ("adapters", "ontology", "server", "shapes")
PYTEST = ("-m", "pytest", "-q", "--timeout", "60")
KINDS = ("comparison turned round", "constant changed", "statement left out", "branch always taken")
OPPOSITE = {"==": "!=", "!=": "==", "<": ">=", ">=": "<", ">": "<=", "<=": ">", "is": "is not", "in": "not in"}
HITS = """\
import os

SEEN = set()


def hit(fault):
    test = os.environ.get("PYTEST_CURRENT_TEST", "").partition(" ")[0]
    if test and (fault, test) not in SEEN:
        SEEN.add((fault, test))
        with open({file!r}, "a") as hits:
            hits.write(f"{{fault}}\\t{{os.environ['PYTEST_CURRENT_TEST']}}\\n")
"""
"""The module of a recording. A process knows its test by pytest's variable; forks take it over in `tests/forked.py`."""

Position = tuple[int, int]


@dataclass(frozen=True)
class Fault:
    """A change of some characters of a file; `place` is the expression or the statement around them."""

    file: str
    kind: str
    place: tuple[Position, Position]
    start: Position
    end: Position
    text: str

    def __str__(self) -> str:
        return f"{self.file}:{self.start[0]} {self.kind}: {self.text.strip() or '(nothing)'}"


# Where faults can be made


def faults_of(file: str, source: str) -> Iterator[Fault]:
    """Yield all the faults that can be made in a file."""
    lines = source.splitlines(keepends=True)
    tree = ast.parse(source)
    skipped = {id(one) for node in ast.walk(tree) for one in _not_run(node)}

    def text(start: Position, end: Position) -> str:
        first, last = start[0] - 1, end[0] - 1
        encoded = [line.encode() for line in lines[first : last + 1]]
        encoded[-1] = encoded[-1][: end[1]]
        encoded[0] = encoded[0][start[1] :]
        return b"".join(encoded).decode()

    def visit(node: ast.AST) -> Iterator[Fault]:
        if id(node) in skipped:
            return
        for kind, start, end, new in _changes(node, text):
            place = node.test if isinstance(node, ast.If) else node
            assert isinstance(place, ast.expr | ast.stmt)
            yield Fault(file, kind, ((place.lineno, place.col_offset), _end(place)), start, end, new)
        for child in ast.iter_child_nodes(node):
            yield from visit(child)

    yield from visit(tree)


def _not_run(node: ast.AST) -> Iterator[ast.AST]:
    """Yield what is documentation, a type, or text put together: a change there is no fault."""
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        yield node
    elif isinstance(node, ast.JoinedStr):
        yield from node.values
    elif isinstance(node, ast.AnnAssign | ast.arg) and node.annotation:
        yield node.annotation
    elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.returns:
        yield node.returns
    elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
        yield node


def _end(node: ast.expr | ast.stmt) -> Position:
    return node.end_lineno or 0, node.end_col_offset or 0


def _changes(node: ast.AST, text: Callable[[Position, Position], str]) -> Iterator[tuple[str, Position, Position, str]]:
    if not isinstance(node, ast.expr | ast.stmt):
        return
    start, end = (node.lineno, node.col_offset), _end(node)
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        left, right = node.left, node.comparators[0]
        between = _end(left), (right.lineno, right.col_offset)
        old = text(*between)
        found = re.search(r"==|!=|<=|>=|<|>|\bis not\b|\bnot in\b|\bis\b|\bin\b", old)
        if found:
            opposite = OPPOSITE.get(found[0]) or found[0].replace("is not", "is").replace("not in", "in")
            yield KINDS[0], *between, old[: found.start()] + opposite + old[found.end() :]
    elif isinstance(node, ast.Constant) and start[0] == end[0]:
        if isinstance(node.value, bool):
            yield KINDS[1], start, end, repr(not node.value)
        elif isinstance(node.value, int | float):
            yield KINDS[1], start, end, f"({node.value!r} + 1)"
        elif isinstance(node.value, str) and node.value and " " not in node.value:
            yield KINDS[1], start, end, repr(node.value + "x")
    elif isinstance(node, ast.Expr | ast.AugAssign | ast.Raise):
        yield KINDS[2], start, end, "pass" + "\n" * (end[0] - start[0])
    elif isinstance(node, ast.If):
        test = node.test
        begin, finish = (test.lineno, test.col_offset), _end(test)
        yield KINDS[3], begin, finish, f"(True or ({text(begin, finish)}))"


def chosen(tree: Path, seed: int, count: int) -> list[Fault]:
    """Return as many faults of each kind, chosen by the hash of the seed and the line."""
    ranked: dict[str, list[tuple[bytes, Fault]]] = defaultdict(list)
    for package in PACKAGES:
        for path in sorted((tree / package).rglob("*.py")):
            file, source = str(path.relative_to(tree)), path.read_text()
            lines = source.splitlines()
            seen: Counter[str] = Counter()
            for fault in faults_of(file, source):
                place = f"{seed} {file} {fault.kind} {lines[fault.start[0] - 1]} {fault.text}"
                seen[place] += 1
                ranked[fault.kind].append((hashlib.sha256(f"{place} {seen[place]}".encode()).digest(), fault))
    return [fault for kind in KINDS for _, fault in sorted(ranked[kind], key=lambda one: one[0])[: count // len(KINDS)]]


def changed(source: str, fault: Fault) -> str:
    """Return the source with the fault in it."""
    lines = [line.encode() for line in source.splitlines(keepends=True)]
    (first, left), (last, right) = fault.start, fault.end
    joined = lines[first - 1][:left] + fault.text.encode() + lines[last - 1][right:]
    return b"".join([*lines[: first - 1], joined, *lines[last:]]).decode()


# Which tests run the place of a fault


def record(tree: Path, faults: Sequence[Fault], arguments: Sequence[str]) -> dict[str, list[str]]:
    """Run all the tests of a copy of the tree that notes each run of a place; return the tests of each fault."""
    with tempfile.TemporaryDirectory() as folder:
        copy = _copied(tree, Path(folder) / "tree")
        hits = Path(folder) / "hits"
        hits.touch()
        (copy / "adapters" / "mutant_hits.py").write_text(HITS.format(file=str(hits)))
        for file in {fault.file for fault in faults}:
            source = (copy / file).read_text()
            notes = [note for n, fault in enumerate(faults) if fault.file == file for note in _notes(source, n, fault)]
            (copy / file).write_text(_with(source, notes))
        subprocess.run([sys.executable, *PYTEST, *arguments], cwd=copy, env={**os.environ, "PYTHONPATH": str(copy)})
        found: dict[int, list[str]] = defaultdict(list)
        for line in hits.read_text().splitlines():
            number, _, test = line.partition("\t")
            found[int(number)].append(test)
    return {str(fault): spread(found[number]) for number, fault in enumerate(faults)}


def _notes(source: str, number: int, fault: Fault) -> list[tuple[Position, str]]:
    """Return the insertions that note a run of a place, of any function of its file where it runs at import."""
    call = f"__import__('rosld.adapters.mutant_hits', fromlist=['hit']).hit({number})"
    start, end = fault.place
    functions = [
        node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    if any((one.body[0].lineno, one.body[0].col_offset) <= start and end <= _end(one) for one in functions):
        notes = [(start, f"{call}; ")] if fault.kind == KINDS[2] else [(start, f"({call} or ("), (end, "))")]
        with suppress(SyntaxError):  # a pattern of `match`
            ast.parse(_with(source, notes))
            return notes
    first = [one.body[0] for one in functions if one.body[0].lineno > one.lineno]
    return [((one.lineno, one.col_offset), f"{call}\n{' ' * one.col_offset}") for one in first]


def _with(source: str, insertions: Iterable[tuple[Position, str]]) -> str:
    lines = [line.encode() for line in source.splitlines(keepends=True)]
    for (line, column), text in sorted(insertions, reverse=True):
        lines[line - 1] = lines[line - 1][:column] + text.encode() + lines[line - 1][column:]
    return b"".join(lines).decode()


def _copied(tree: Path, copy: Path) -> Path:
    ignored = shutil.ignore_patterns(".git", ".venv*", ".crawl", ".mutants", ".mypy_cache", "node_modules", "target")
    shutil.copytree(tree, copy, symlinks=True, ignore=ignored)
    for venv in tree.glob(".venv-ros2-*"):
        (copy / venv.name).symlink_to(venv)
    return copy


def spread(contexts: Iterable[str]) -> list[str]:
    """Return the tests that ran a place, spread over their files."""
    by_file: dict[str, set[str]] = defaultdict(set)
    for context in contexts:
        test, phase = context.rsplit(" ", 1)
        file = test.partition("::")[0]
        by_file[file].add(file if phase == "(setup)" else test)  # a fixture may serve all tests of its file
    turns = [[file] if file in tests else sorted(tests) for file, tests in by_file.items()]
    turns.sort(key=lambda tests: ("::" not in tests[0], tests))
    return [tests[turn] for turn in range(max(map(len, turns), default=0)) for tests in turns if turn < len(tests)]


# Whether it is noticed


def judged(fault: Fault, tests: Sequence[str], tree: Path, limit: float) -> str:
    """Return `noticed`, `not noticed`, or `not run` where no test runs the line."""
    if not tests:
        return "not run"
    path = tree / fault.file
    source = path.read_text()
    left = list(tests)
    while left:
        path.write_text(changed(source, fault))
        try:
            failed = _failed(left, tree, limit)
        finally:
            path.write_text(source)
        if failed is None:
            return "not noticed"
        again = [one for one in failed if one != "-"]
        if not again or _failed(again, tree, limit) is None:
            return "noticed"
        left = [one for one in left if one not in again and one.partition("::")[0] not in again]
    return "not noticed"


def _failed(tests: Sequence[str], tree: Path, limit: float) -> list[str] | None:
    """Run tests up to the first that fails; return it, `-` where there is no telling which, None if all pass."""
    environment = {**os.environ, "PYTHONPATH": str(tree), "HYPOTHESIS_STORAGE_DIRECTORY": str(tree / ".hypothesis")}
    process = subprocess.Popen(
        [sys.executable, *PYTEST, "-p", "no:cacheprovider", "-x", "-rfE", *tests],
        cwd=tree, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
    )  # fmt: skip
    try:
        output, _ = process.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, 9)
        process.communicate()
        return None
    if process.returncode == 0:
        return None
    return re.findall(r"^(?:FAILED|ERROR) (tests/.*?)(?: - .*)?$", output, re.MULTILINE)[:1] or ["-"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", nargs="?", choices=("judge", "record"), default="judge")
    parser.add_argument("--tree", type=Path, default=Path(__file__).parent.parent, help="the checkout")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=80)
    parser.add_argument("--jobs", type=int, default=2, help="how many faults are judged at once, each in its own copy")
    parser.add_argument("--tests", type=int, default=60, help="how many tests are run for one fault at most")
    parser.add_argument("--limit", type=float, default=180, help="seconds for the tests of one fault at most")
    given, others = parser.parse_known_args()
    tree: Path = given.tree.resolve()
    faults, recorded = chosen(tree, given.seed, given.count), tree / ".mutants" / f"{given.seed}.json"
    if given.command == "record":
        recorded.parent.mkdir(exist_ok=True)
        recorded.write_text(json.dumps(record(tree, faults, others), indent=1))
        return
    tests = json.loads(recorded.read_text())
    results: list[tuple[Fault, str]] = []
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(given.jobs) as pool:
        copies = [_copied(tree, Path(folder) / str(number)) for number in range(given.jobs)]

        def judge(fault: Fault) -> tuple[Fault, str]:
            copy = copies.pop()
            try:
                return fault, judged(fault, tests.get(str(fault), [])[: given.tests], copy, given.limit)
            finally:
                copies.append(copy)

        for fault, verdict in pool.map(judge, faults):
            results.append((fault, verdict))
            print(f"{verdict:12} {fault}", flush=True)
    print(json.dumps(Counter(verdict for _, verdict in results)))


if __name__ == "__main__":
    main()
