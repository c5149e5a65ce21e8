"""The documentation in this installation: its files, its pages as HTML, and the search in them."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib.resources import files
from itertools import pairwise
from pathlib import Path

from markupsafe import Markup
from msgspec import Struct

ROUTE = "docs"
FOLDERS = {"tutorial": "Tutorial", "how-to": "How-to guides", "reference": "Reference", "explanation": "Explanation"}
"""Titles of the folders, in the order in which readers need them."""
MAX_FOUND = 30
_LENGTH = 240
"""Number of characters of a section that a search result shows."""
_INDEX = "README.md"
_FENCE = re.compile(r"^(```|~~~)")
_HEADING = re.compile(r"^(#{1,6}) (.*?)#*$")
_MARKUP = re.compile(r"!?\[([^\]]*)\]\([^)]*\)|[`*]|^[|: -]+$", re.MULTILINE)


@cache
def documents() -> Mapping[str, Path]:
    """Return the files by path below `/docs/`; a page has no suffix, and the index is the empty path."""
    root = Path(str(files("rosld") / ROUTE))
    paths = sorted(path for path in root.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    names = {path: path.relative_to(root).as_posix() for path in paths}
    return {"" if name == _INDEX else name.removesuffix(".md"): path for path, name in names.items()}


def is_page(name: str) -> bool:
    """Whether a path below `/docs/` is that of a page."""
    return name in documents() and documents()[name].suffix == ".md"


class Section(Struct, frozen=True):
    """A section of a page: its heading, the anchor of that (empty for the title), and its text without markup."""

    page: str
    heading: str
    anchor: str
    text: str
    level: int = 1

    @property
    def href(self) -> str:
        """Reference relative to `/docs/`."""
        return f"{self.page}#{self.anchor}" if self.anchor else self.page


def _plain(text: str) -> str:
    """Return Markdown as words."""
    return " ".join(_MARKUP.sub(lambda found: found[1] or "", text).replace("|", " ").split())


def anchor_of(heading: str, used: dict[str, int]) -> str:
    """Return the anchor of a heading as on GitHub, and count it in `used`."""
    slug = re.sub(r"[^\w\- ]", "", _plain(heading).lower()).replace(" ", "-")
    used[slug] = used.get(slug, -1) + 1
    return f"{slug}-{used[slug]}" if used[slug] else slug


@cache
def sections(name: str) -> Sequence[Section]:
    """Return the sections of a page, the first with its title."""
    return tuple(_split(name, documents()[name].read_text("utf-8")))


def _split(name: str, text: str) -> Iterator[Section]:
    heading, lines, used, fenced, level = "", list[str](), dict[str, int](), False, 1
    anchor = ""
    for line in [*text.splitlines(), "# "]:
        fenced ^= bool(_FENCE.match(line))
        found = None if fenced else _HEADING.match(line)
        if found is None:
            lines.append(line)
            continue
        if heading:
            yield Section(name, _plain(heading), anchor, _plain("\n".join(lines)), level)
        is_title, heading, level, lines = not used, found[2], len(found[1]), []
        anchor = anchor_of(heading, used)
        anchor = "" if is_title else anchor


def title_of(name: str) -> str:
    """Return the title of a page."""
    return sections(name)[0].heading


class Found(Struct, frozen=True):
    """A search result: the title of the page, a section of it, and an excerpt."""

    title: str
    section: Section
    excerpt: str


def search(words: str) -> Sequence[Found]:
    """Return the sections with all words, the best first; those with some of them if there is none."""
    wanted = words.lower().split()
    scored = []
    for name in filter(is_page, documents()):
        for section in sections(name):
            title = title_of(name).lower()
            scores = [_score(word, section, title) for word in wanted]
            scored.append((sum(map(bool, scores)), sum(scores), section))
    best = max((matched for matched, *_ in scored), default=0)
    found = sorted((each for each in scored if best and each[0] == best), key=lambda each: -each[1])
    return [Found(title_of(each.page), each, _excerpt(each.text, wanted)) for *_, each in found[:MAX_FOUND]]


def _score(word: str, section: Section, title: str) -> float:
    """Return how well a section matches a word: 0 if it does not contain it."""
    count = section.text.lower().count(word)
    return 8 * (word in section.heading.lower()) + 4 * (word in title) + min(count, 5) / 2


def _excerpt(text: str, words: Sequence[str]) -> str:
    places = [place for word in words if (place := text.lower().find(word)) >= 0]
    start = max(0, min(places, default=0) - _LENGTH // 3)
    start = text.find(" ", start) + 1 if start else 0
    return ("… " if start else "") + text[start : start + _LENGTH] + (" …" if start + _LENGTH < len(text) else "")


@cache
def page_body(name: str, root: str) -> Markup:
    """Return the HTML of a page below its title; `root` is the path of the server's base."""
    from markdown_it import MarkdownIt  # 50 ms, and only the documentation needs it

    parser = MarkdownIt("commonmark", {"html": False}).enable("table")
    tokens, used = parser.parse(documents()[name].read_text("utf-8")), dict[str, int]()
    for token, content in pairwise(tokens):
        if token.type == "heading_open":
            token.attrSet("id", anchor_of(content.content, used))
    for token in tokens:
        for child in token.children or ():
            for attribute in {"link_open": ("href",), "image": ("src",)}.get(child.type, ()):
                child.attrSet(attribute, _target(str(child.attrs[attribute]), name, root))
    is_titled = bool(tokens) and tokens[0].tag == "h1"
    return Markup(parser.renderer.render(tokens[3 if is_titled else 0 :], parser.options, {}))


def _target(link: str, page: str, root: str) -> str:
    """Return a link of a page as on the server."""
    path, hash_, anchor = link.partition("#")
    if re.match(r"[a-z]+:", link) or not path:
        return link
    path = posixpath.normpath(posixpath.join(posixpath.dirname(page), path))
    path = "" if path == _INDEX else path.removesuffix(".md")
    return f"{root}{ROUTE}/{path}{hash_}{anchor}"
