"""The documentation: every link resolves, and the output in pages about embedded robots is the actual one."""

from __future__ import annotations

import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from urllib.parse import unquote

import pytest

from tests.server.conftest import Served, servers
from tests.waiting import until

ROOT = Path(__file__).parent.parent
LINK = re.compile(r"\]\(([^()\s]+)\)")
FENCE = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)


def pages() -> list[Path]:
    return [ROOT / name for name in ("README.md", "CONTRIBUTING.md")] + sorted(ROOT.glob("docs/**/*.md"))


@cache
def anchors(page: Path) -> frozenset[str]:
    """Return the anchors of a page's headings, as in GitHub."""
    found: dict[str, int] = {}
    for heading in re.findall(r"^#+ (.*)$", FENCE.sub("", page.read_text("utf-8")), re.MULTILINE):
        text = re.sub(r"[^\w\- ]", "", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()).replace(" ", "-")
        found[text] = found.get(text, -1) + 1
    return frozenset(
        text if number == 0 else f"{text}-{number}" for text, limit in found.items() for number in range(limit + 1)
    )


def test_every_relative_link_leads_to_a_file_and_a_heading() -> None:
    broken = []
    for page in pages():
        for link in LINK.findall(FENCE.sub("", page.read_text("utf-8"))):
            if re.match(r"[a-z]+:", link):
                continue
            path, _, anchor = link.partition("#")
            target = page if not path else (page.parent / unquote(path)).resolve()
            if not target.exists() or (anchor and target.suffix == ".md" and anchor not in anchors(target)):
                broken.append(f"{page.relative_to(ROOT)}: {link}")
    assert not broken


@pytest.mark.skipif((ROOT / "PKG-INFO").exists(), reason="links of a released README lead to the repository")
def test_every_page_is_reached_from_the_readme() -> None:
    waiting, seen = [ROOT / "README.md"], {ROOT / "README.md"}
    while waiting:
        page = waiting.pop()
        for link in LINK.findall(page.read_text("utf-8")):
            target = (page.parent / link.partition("#")[0]).resolve()
            if target.suffix == ".md" and target.is_file() and target not in seen:
                seen.add(target)
                waiting.append(target)
    assert not [str(page.relative_to(ROOT)) for page in pages() if page.resolve() not in seen]


def test_the_reference_of_adapters_is_up_to_date() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "adapter_reference.py"))
    assert script["PAGE"].read_text("utf-8").endswith("\n" + script["reference"]()), "run docs/adapter_reference.py"


PRINTED = "http://127.0.0.1:8080/"
CONSOLE = re.compile(r"^```console\n(.*?)^```", re.DOTALL | re.MULTILINE)


def commands(page: Path) -> Iterator[tuple[str, list[str]]]:
    """Yield the commands of a page in order, each with its printed lines; `...` stands for any."""
    for block in CONSOLE.findall(page.read_text("utf-8")):
        for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
            command, *output = part.rstrip().splitlines()
            while output and (command.endswith("\\") or command.count("'") % 2):
                command = f"{command}\n{output.pop(0)}"
            yield command, output


def prints(expected: list[str], lines: list[str]) -> bool:
    """Whether lines are as expected."""
    if not expected:
        return not lines
    if expected[0] == "...":
        return any(prints(expected[1:], lines[skipped:]) for skipped in range(len(lines) + 1))
    return bool(lines) and lines[0].rstrip() == expected[0].rstrip() and prints(expected[1:], lines[1:])


MEASURED = re.compile(r"\d{4}-\d\d-\d\dT[\d:.]+Z|\d+\.\d+(e-?\d+)?|(?<=sequence )\d+|(?<=,)\d+$")
"""Parts of pages that vary: times, measurements, numbers and counts of messages."""


def serve(start: Callable[..., Served], command: str) -> str:
    """Start a server as with a command such as `rosld serve rover --history '*' &`, on a free port; return its URL."""
    _, _, *arguments = shlex.split(command.removesuffix("&"))
    served = start(*arguments)
    if "--history" in arguments:
        past = "/topics/battery_state?series=percentage&points=3&format=csv"
        until(lambda: "min" in served.http.get(past).text, "a past of more than three messages")
    return served.url


@pytest.mark.slow
@pytest.mark.parametrize(
    ("page", "command"),
    [
        ("README.md", "rosld serve rover"),
        ("docs/tutorial/aircraft.md", "rosld serve aircraft"),
        ("docs/how-to/data.md", "rosld serve aircraft"),
        ("docs/how-to/rover.md", "rosld serve rover"),
        ("docs/how-to/faults.md", "rosld serve rover"),
        ("docs/how-to/robots.md", "rosld serve rover=rover plane=aircraft"),
    ],
)
def test_a_page_on_an_embedded_robot_prints_what_it_shows(page: str, command: str, tmp_path: Path) -> None:
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    with servers() as start:
        url = serve(start, command)
        for shown, expected in commands(ROOT / page):
            if shown.startswith("rosld serve "):
                url = serve(start, shown)
            if shown.startswith("rosld serve ") or " -N " in shown:
                continue  # the latter follows a stream without an end
            run = shown.replace(PRINTED, url).replace(".venv/bin/python", sys.executable)
            done = subprocess.run(["bash", "-c", run], cwd=tmp_path, capture_output=True, text=True, timeout=60)
            printed = done.stdout.replace(url, PRINTED)
            wanted = [MEASURED.sub("0", line) for line in expected]
            found = MEASURED.sub("0", printed).splitlines()
            assert prints(wanted, found), f"{shown}\n{done.stdout}\n{done.stderr}"


BLOCK = re.compile(r"^```(python|toml|diff)\n(.*?)^```", re.DOTALL | re.MULTILINE)


def add_lines(root: Path, diff: str) -> None:
    """Add the `+` lines of a diff without line numbers to the files below `root`; `...` separates places of a file."""
    for section in diff.split("--- ")[1:]:
        name, _, body = section.partition("\n")
        text = (root / name).read_text("utf-8") if (root / name).exists() else "\n"
        for place in body.split("...\n"):
            lines = place.splitlines()
            old = "\n" + "".join(f"{line[1:]}\n" for line in lines if not line.startswith("+")).rstrip("\n")
            assert text.count(old) == 1, (name, old)
            text = text.replace(old, "\n" + "\n".join(line[1:] for line in lines))
        (root / name).write_text(text.lstrip("\n"), "utf-8")


@pytest.mark.slow
@pytest.mark.skipif((ROOT / "PKG-INFO").exists(), reason="a source distribution has copies instead of links")
def test_the_examples_of_the_architecture_add_an_adapter_a_function_a_resource_and_a_panel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for part in ("rosld", "adapters", "ontology", "queries", "server", "shapes"):
        shutil.copytree(ROOT / part, tmp_path / part, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    (plugin := tmp_path / "thermometer-1.dist-info").mkdir()
    (plugin / "METADATA").write_text("Metadata-Version: 2.1\nName: thermometer\nVersion: 1\n")
    blocks = BLOCK.findall((ROOT / "docs" / "explanation" / "architecture.md").read_text("utf-8"))
    assert [kind for kind, _ in blocks] == ["python", "toml", "diff", "diff", "diff"]
    for kind, text in blocks:
        assert text.count("\n") <= 40, text
        if kind == "diff":
            add_lines(tmp_path, text)
        elif kind == "python":
            (tmp_path / "thermometer.py").write_text(text, "utf-8")
        else:
            section, entry = text.splitlines()
            assert section == '[project.entry-points."rosld.adapters"]'
            (plugin / "entry_points.txt").write_text(f"[rosld.adapters]\n{entry.replace(chr(34), '')}\n")
    monkeypatch.chdir(tmp_path)  # its rosld is the one that runs
    with servers() as start:
        http = start("thermometer:", environment={**os.environ, "PYTHONPATH": str(tmp_path)}).http
        until(lambda: http.get("topics/temperature?format=json").json(), "a temperature")
        assert http.get("topics/temperature?format=json").json() == {"data": 20.5}
        query = 'PREFIX ros: <https://w3id.org/rosld#> SELECT (ros:sum("[1,2.5]"^^rdf:JSON) AS ?sum) {}'
        prefix = "PREFIX rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> "
        answer = http.get("sparql", params={"query": prefix + query}, headers={"Accept": "text/csv"})
        assert answer.text.split() == ["sum", "3.5"]
        assert http.get("uptime?format=json").json() > 0
        assert "ros:duration" in http.get("uptime").text
        cockpit = (
            "@prefix ros: <https://w3id.org/rosld#> . <> a ros:Cockpit ;"
            " ros:hasPanel [ a ros:TypePanel ; ros:shows </topics/temperature> ] ."
        )
        http.put("cockpit/types", content=cockpit, headers={"Content-Type": "text/turtle"}).raise_for_status()
        assert "https://w3id.org/rosld#Topic" in http.get("cockpit/types", headers={"Accept": "text/html"}).text
