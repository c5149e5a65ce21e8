"""Problem (RFC 9457): the exception for every refusal and failure that clients see.

`problem_details.py` renders them. A body says what the client sent and what to do next, and never how the server is
made: no traceback, no path of a file, no class.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from http import HTTPStatus
from typing import TYPE_CHECKING

from rosld.server.http.token_redaction import redact_tokens, redact_tokens_in

if TYPE_CHECKING:  # what a problem needs is little, so that the query process can raise one
    from rosld.ontology.violations import Violation


class Problem(Exception):
    """Ends a request with a status of 400 or more.

    `detail` names the value and the next step; `title` is the status's phrase where none is given; `headers` go into
    the response; `extra` holds further members (RFC 9457 3.2); `violations` say field by field what does not fit.
    `about` are URLs of what the reason speaks of: one who may not read them all is not told it. `near` are URLs of what
    is there, where the one that was asked for is not and is spelt much like them.
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
        self.extra = {name: redact_tokens_in(value) for name, value in extra.items()}
        self.violations = tuple(map(_without_tokens, violations))
        self.about = tuple(about)
        self.near = tuple(near)

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


def reason_phrase(status: int) -> str:
    """The reason phrase of a status, such as "Not Found"."""
    try:
        return HTTPStatus(status).phrase
    except ValueError:
        return f"Status {status}"


def _without_tokens(violation: Violation) -> Violation:
    value = None if violation.value is None else redact_tokens(violation.value)
    path, message = redact_tokens(violation.path), redact_tokens(violation.message)
    same = (path, message, value) == (violation.path, violation.message, violation.value)
    return violation if same else replace(violation, path=path, message=message, value=value)
