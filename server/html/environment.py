"""The templates of pages, read and compiled once: what they print is escaped."""

from __future__ import annotations

import re
from functools import cache
from importlib.resources import files

from jinja2 import DictLoader, Environment, StrictUndefined
from markupsafe import Markup

from rosld.server.html.auto_refresh import MAX_RATE
from rosld.server.html.forms import CHOICE_FIELD, METHOD_FIELD
from rosld.server.html.frame import Frame
from rosld.server.html.view import escape_controls
from rosld.server.http.origin import CSRF_FIELD

_PARTS = re.compile(r"/?[^/_]+[/_]*|[/_]+")
_LONGEST_WORD = 30
"""Characters that fit into a line on a phone."""


@cache
def _environment() -> Environment:
    folder = files("rosld.server.html") / "templates"
    texts = {each.name: each.read_text("utf-8") for each in folder.iterdir() if each.name.endswith(".html")}
    environment = Environment(
        loader=DictLoader(texts),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_printable,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["breakable"] = _breakable
    environment.filters["grouped"] = lambda number: f"{number:,}"
    environment.globals |= {"csrf_field": CSRF_FIELD, "method_field": METHOD_FIELD, "choice_field": CHOICE_FIELD}
    environment.globals["live_rate"] = MAX_RATE
    return environment


def prepare_pages() -> None:
    """Compile the templates, which takes a quarter of a second, so that no page waits for it. From any thread."""
    environment = _environment()
    for name in environment.list_templates():
        environment.get_template(name)


def render_template(template: str, frame: Frame, **values: object) -> bytes:
    """The page that a template of `templates/` makes of a frame and values, in UTF-8.

    A value that the template names and that is not given is an error; half a surrogate pair becomes a question mark.
    """
    text = _environment().get_template(template).render(frame=frame, site=frame.site, **values)
    return text.encode("utf-8", "replace")


def _breakable(text: str) -> Markup:
    """A name that lines break after its slashes and underscores, and within a word only where that is very long."""
    parts = _PARTS.findall(escape_controls(text))
    name = Markup("<wbr>").join(parts)
    if len(parts) <= 1 or max(map(len, parts)) > _LONGEST_WORD:
        return name
    return Markup('<span class="whole">{}</span>').format(name)


def _printable(value: object) -> object:
    """What the templates print: escaping makes text harmless, this makes it something HTML can hold."""
    return escape_controls(value) if type(value) is str else value
