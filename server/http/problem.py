"""Problem (RFC 9457): the exception for every refusal and failure that clients see.

`problem_details.py` renders them. A body says what the client sent and what to do next, and never how the server is
made: no traceback, no path of a file, no class.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from http import HTTPStatus
from typing import TYPE_CHECKING

from rosld.server.http.token_redaction import redact_tokens, redact_tokens_in

if TYPE_CHECKING:  # what a problem needs is little, so that the query process can raise one
    from rosld.ontology.violations import Violation


ROBOT_SAID, AGENT_SAID = "robotSaid", "agentSaid"
"""The members for words of the robot and of another agent: data, never a part of `detail` or `title`."""
_MAX_SAID = 500
"""Characters of what is quoted."""
_QUOTED = {
    ROBOT_SAID: "The robot said",
    "holder": "Held by",
    "stoppedBy": "Stopped by",
    AGENT_SAID: "The reason given",
}
"""The members that quote others, names included, and what stands before each for people."""


class Problem(Exception):
    """A refusal or failure with a status of 400 or more.

    `detail` names the value and the next step; `title` is the status's phrase where none is given; `headers` go into
    the response; `extra` holds further members (RFC 9457 3.2); `violations` say field by field what does not fit.
    Words of the robot or of another agent stand in members of their own (`quoted`), never in `detail` or `title`; those
    of the shapes that were broken are taken from the violations.
    `about` are URLs that the reason mentions: an agent that may not read them all does not get it. `near` are URLs of
    existing resources with names similar to a missing one.
    """

    def __init__(
        self,
        status: int,
        detail: str,
        *,
        title: str | None = None,
        type: str = "about:blank",
        headers: Mapping[str, str] = {},
        extra: Mapping[str, object] = {},
        violations: Sequence[Violation] = (),
        about: Sequence[str] = (),
        near: Sequence[str] = (),
    ) -> None:
        super().__init__(f"{status} {redact_tokens(detail)}")
        self.status = status
        self.detail = detail
        self.title = title or reason_phrase(status)
        self.type = type
        self.headers = dict(headers)
        self.violations = tuple(map(_cleaned, violations))
        said = "; ".join(dict.fromkeys(each.said for each in self.violations if each.said))
        extra = {AGENT_SAID: said} | dict(extra) if said else extra
        self.extra = {name: redact_tokens_in(value) for name, value in _with_quotations(extra).items()}
        self.about = tuple(about)
        self.near = tuple(near)

    @property
    def said(self) -> dict[str, str]:
        """The members that quote others."""
        return quoted(self.extra)

    @property
    def quotes(self) -> tuple[tuple[str, str], ...]:
        """The same for people: who said it, and what."""
        return tuple((_QUOTED[name], words) for name, words in self.said.items())

    @property
    def with_quotes(self) -> str:
        """Why, with the words of others as quotations: for people and receipts."""
        return " ".join(
            (self.detail, *(f"{who}: {json.dumps(words, ensure_ascii=False)}." for who, words in self.quotes))
        )

    @property
    def detail(self) -> str:
        """Why, and what to do next: never with a token of rosld in it."""
        return self._detail

    @detail.setter
    def detail(self, words: str) -> None:
        self._detail = redact_tokens(words)

    def __reduce__(self) -> tuple[object, ...]:
        """Worker processes raise problems, too."""
        told = (self.status, self.detail, self.title, self.type, self.headers, self.extra, self.violations)
        return _problem, told


def _problem(
    status: int,
    detail: str,
    title: str,
    type: str,
    headers: Mapping[str, str],
    extra: Mapping[str, object],
    violations: Sequence[Violation],
) -> Problem:
    return Problem(status, detail, title=title, type=type, headers=headers, extra=extra, violations=violations)


def quoted(members: Mapping[str, object]) -> dict[str, str]:
    """Return the members that quote others, on one line and cut, without characters that nobody sees."""
    return {name: words for name in _QUOTED if (words := one_line(members.get(name)))}


def _with_quotations(extra: Mapping[str, object]) -> dict[str, object]:
    return {name: value for name, value in extra.items() if name not in _QUOTED} | quoted(extra)


def one_line(words: object) -> str:
    """Return foreign words fit to be quoted; "" for what is no text."""
    if not isinstance(words, str):
        return ""
    line = " ".join(words[: 4 * _MAX_SAID].split())
    shown = "".join(filter(str.isprintable, line))
    return shown if len(shown) <= _MAX_SAID else f"{shown[:_MAX_SAID]}..."


def reason_phrase(status: int) -> str:
    """Return the reason phrase of a status, such as "Not Found"."""
    try:
        return HTTPStatus(status).phrase
    except ValueError:
        return f"Status {status}"


def _cleaned(violation: Violation) -> Violation:
    """Return it without tokens, and with the shape's message fit to be quoted."""
    value = None if violation.value is None else redact_tokens(violation.value)
    path, message = redact_tokens(violation.path), redact_tokens(violation.message)
    said = None if violation.said is None else redact_tokens(one_line(violation.said)) or None
    same = (path, message, value, said) == (violation.path, violation.message, violation.value, violation.said)
    return violation if same else replace(violation, path=path, message=message, value=value, said=said)
