"""Problem (RFC 9457): the exception for every refusal and failure that clients see.

`problem_details.py` renders them. A body states what was wrong in the request and what to do next, and never reveals
internals of the server: no traceback, file path or class.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import TYPE_CHECKING

from msgspec.structs import replace

from rosld.server.http.token_redaction import redact_tokens, redact_tokens_in

if TYPE_CHECKING:  # the query process raises problems, and must import little
    from rosld.ontology.violations import Violation


ROBOT_SAID, AGENT_SAID = "robotSaid", "agentSaid"
"""Members for text of the robot and of another agent: data, never a part of `detail` or `title`."""
READ_ONLY = "This server is read-only."
_MAX_SAID = 500
"""Maximum number of quoted characters."""
_QUOTED = {
    ROBOT_SAID: "The robot said",
    "holder": "Held by",
    "stoppedBy": "Stopped by",
    AGENT_SAID: "Reason given",
}
"""Members that quote others, names included, and their labels on pages."""


class Problem(Exception):
    """A refusal or failure with a status of 400 or more.

    `detail` names the value and the next step; `title` defaults to the status's phrase; `headers` are added to the
    response; `extra` holds further members (RFC 9457 3.2); `violations` are the errors of single fields. Text of the
    robot or of another agent belongs in members of its own (`quoted`), never in `detail` or `title`; that of violated
    shapes is in the violations. `about` are URLs that the reason mentions: an agent that may not read them all does not
    get it. `near` are URLs of existing resources with names similar to a missing one.
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
        quotation = "; ".join(dict.fromkeys(each.quote for each in self.violations if each.quote))
        extra = {AGENT_SAID: quotation} | dict(extra) if quotation else extra
        self.extra = {name: redact_tokens_in(value) for name, value in _with_quotations(extra).items()}
        self.about = tuple(about)
        self.near = tuple(near)

    @property
    def quoted_members(self) -> dict[str, str]:
        """Members that quote others."""
        return quoted(self.extra)

    @property
    def quotes(self) -> tuple[tuple[str, str], ...]:
        """The quotations with their labels."""
        return tuple((_QUOTED[name], words) for name, words in self.quoted_members.items())

    @property
    def with_quotes(self) -> str:
        """Detail followed by the quotations, for pages and receipts."""
        return " ".join(
            (self.detail, *(f"{who}: {json.dumps(words, ensure_ascii=False)}." for who, words in self.quotes))
        )

    @property
    def detail(self) -> str:
        """Reason and next step, never containing a token of rosld."""
        return self._detail

    @detail.setter
    def detail(self, words: str) -> None:
        self._detail = redact_tokens(words)

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle: worker processes raise problems too."""
        arguments = (self.status, self.detail, self.title, self.type, self.headers, self.extra, self.violations)
        return _problem, arguments


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
    """Return the members that quote others, on one line, truncated, and without invisible characters."""
    return {name: words for name in _QUOTED if (words := one_line(members.get(name)))}


def _with_quotations(extra: Mapping[str, object]) -> dict[str, object]:
    return {name: value for name, value in extra.items() if name not in _QUOTED} | quoted(extra)


def one_line(words: object) -> str:
    """Return text of others, ready to be quoted; "" for anything but text."""
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
    """Return the violation without tokens, and with the shape's message ready to be quoted."""
    value = None if violation.value is None else redact_tokens(violation.value)
    path, message = redact_tokens(violation.path), redact_tokens(violation.message)
    quote = None if violation.quote is None else redact_tokens(one_line(violation.quote)) or None
    same = (path, message, value, quote) == (violation.path, violation.message, violation.value, violation.quote)
    return violation if same else replace(violation, path=path, message=message, value=value, quote=quote)
