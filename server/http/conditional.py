"""Conditional requests (RFC 9110 13) on strong entity tags of the form `"<boot>-<state>.<variant>"`.

`<boot>-<state>` says what the resource is like, `<variant>` in which representation it was read. If-None-Match
of a read compares all of it; If-Match, and If-None-Match of a write, the state only, so that somebody who read Turtle
can guard a write in JSON.
"""

from __future__ import annotations

import hashlib
import re
import secrets
from dataclasses import dataclass
from enum import Enum
from typing import Literal, TypeAlias

from rosld.server.http.problem import Problem

# Looser than RFC 9110 8.8.3: a tag with a space in it is none of ours, so it matches nothing (412).
_OPAQUE = r'[^"\x00-\x08\x0a-\x1f\x7f]*'
_TAG = re.compile(rf'(W/)?"({_OPAQUE})"')
_LIST = re.compile(rf'[ \t,]*(?:W/)?"{_OPAQUE}"[ \t]*(?:,[ \t]*(?:(?:W/)?"{_OPAQUE}"[ \t]*)?)*')
_PART = re.compile(r"[0-9A-Za-z_+\-]+(?:\.[0-9A-Za-z_+\-]+)*")
_VARIANT = re.compile(r"[0-9A-Za-z_+\-]+")
_SAFE_METHODS = frozenset({"GET", "HEAD"})
_SECRET = secrets.token_bytes(32)


@dataclass(frozen=True, slots=True)
class ETag:
    """A strong entity tag: the state (`<boot>-<state>`) and the variant, which holds no dot.

    Raises ValueError for parts that could not be read back.
    """

    state: str
    variant: str

    def __post_init__(self) -> None:
        if not _PART.fullmatch(self.state) or not _VARIANT.fullmatch(self.variant):
            raise ValueError(f"{self.state!r} and {self.variant!r} make no entity tag")

    def __str__(self) -> str:
        return f'"{self.state}.{self.variant}"'


@dataclass(frozen=True, slots=True)
class ReceivedTag:
    """A tag as a client sent it: its opaque text and whether it is weak."""

    opaque: str
    weak: bool = False

    @property
    def state(self) -> str:
        """The state part, all of it where there is no variant."""
        return self.opaque.rpartition(".")[0] or self.opaque


Tags: TypeAlias = "Literal['*'] | tuple[ReceivedTag, ...]"


class PreconditionResult(Enum):
    """What the preconditions of a request come to; the values are statuses, 0 for none."""

    PROCEED = 0
    NOT_MODIFIED = 304
    PRECONDITION_FAILED = 412


def parse(text: str, name: str = "If-Match") -> Tags:
    """The tags of an If-Match or If-None-Match field, or "*".

    What is no list of quoted strings is a 400 Problem: a guard that cannot be read must not let the write through.
    """
    stripped = text.strip(" \t")
    if stripped == "*":
        return "*"
    if not _LIST.fullmatch(stripped):
        raise Problem(400, f'{name}: {text[:100]!r} is no list of entity tags; one looks like "abc-1.ttl", with quotes')
    return tuple(ReceivedTag(found[2], bool(found[1])) for found in _TAG.finditer(stripped))


def evaluate(
    method: str, current: ETag | None, *, if_match: str | None, if_none_match: str | None
) -> PreconditionResult:
    """Judges a request's preconditions in the order of RFC 9110 13.2.2; `current` is None where nothing is there.

    If-Match uses the strong comparison (a weak tag never matches), If-None-Match the weak one. A write changes all
    representations, so that the tag of any of them is the current one (RFC 9110 13.1.2).
    """
    if if_match is not None and not _any_state(parse(if_match, "If-Match"), current):
        return PreconditionResult.PRECONDITION_FAILED
    if if_none_match is None:
        return PreconditionResult.PROCEED
    tags = parse(if_none_match, "If-None-Match")
    if method in _SAFE_METHODS:
        return PreconditionResult.NOT_MODIFIED if _any_tag(tags, current) else PreconditionResult.PROCEED
    return (
        PreconditionResult.PRECONDITION_FAILED if _any_state(tags, current, weakly=True) else PreconditionResult.PROCEED
    )


def check_preconditions(method: str, current: ETag | None, *, if_match: str | None, if_none_match: str | None) -> bool:
    """As `evaluate`, raising the 412 Problem; True means: answer 304."""
    result = evaluate(method, current, if_match=if_match, if_none_match=if_none_match)
    if result is PreconditionResult.PRECONDITION_FAILED:
        raise Problem(
            412, "The resource is not in the state the request asks for; read it again.", headers=_told(current)
        )
    return result is PreconditionResult.NOT_MODIFIED


def require_if_match(if_match: str | None, why: str) -> str:
    """The If-Match field, which this request must have; else a 428 Problem (RFC 6585 3) with `why`."""
    if if_match is None:
        raise Problem(428, f"{why} Send If-Match with the ETag of the state you have read.")
    return if_match


def _told(current: ETag | None) -> dict[str, str]:
    return {} if current is None else {"ETag": str(current)}


def _any_state(tags: Tags, current: ETag | None, *, weakly: bool = False) -> bool:
    if current is None or isinstance(tags, str):
        return current is not None
    return any((weakly or not tag.weak) and tag.state == current.state for tag in tags)


def _any_tag(tags: Tags, current: ETag | None) -> bool:
    if current is None or isinstance(tags, str):
        return current is not None
    return any(f'"{tag.opaque}"' == str(current) for tag in tags)


def digest(data: bytes) -> str:
    """A short name for these bytes: another one for other bytes.

    It tells nothing of them, not even to one who has all of them but a word to guess.
    """
    return hashlib.blake2b(data, digest_size=9, key=_SECRET).hexdigest()
