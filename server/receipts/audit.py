"""The audit of a request: its context, and the entry with excerpts of bodies without secrets.

All code that writes to the robot records that in `current_audit`, so that resources cannot forget what they affect or
the outcome. Resources may add more to the context of their exchange.

A text that appears to contain credentials is never stored: a false alarm costs an excerpt, a miss reveals a secret.
"""

from __future__ import annotations

import base64
import codecs
import hashlib
import re
import secrets
import time
from collections.abc import Iterable, Sequence
from contextvars import ContextVar
from typing import NamedTuple
from urllib.parse import parse_qsl, unquote, urljoin

from rosld.ontology.describe_activities import Receipt
from rosld.server.auth.rules import Agent
from rosld.server.http.token_redaction import PREFIX, redact_tokens
from rosld.server.runtime.dry_run import MAX_STEPS, current_dry_run


def new_identifier() -> str:
    """Return 72 random bits in 12 characters that need no escaping in a URL."""
    return secrets.token_urlsafe(9)


class Sender(NamedTuple):
    """Sender of a call or a goal: the agent's name and the id of the receipt."""

    agent: str
    receipt: str


class AuditContext:
    """Record of a request's effects; empty for a request that writes nothing.

    `started_ns` is the start of processing, `sent` the SHA-256 of a streamed body of `length` bytes. `leads_to_page`:
    the response redirects a browser to a page, which is to show the receipt.
    """

    __slots__ = (
        "is_write",
        "leads_to_page",
        "length",
        "matched",
        "plan",
        "receipt",
        "refusal",
        "sent",
        "started_ns",
        "touched",
    )

    sent: hashlib._Hash | None

    def __init__(self) -> None:
        self.started_ns = time.time_ns()
        self.is_write = False
        self.leads_to_page = False
        self.plan: tuple[str, ...] = ()
        self.touched: tuple[str, ...] = ()
        self.matched: int | None = None
        self.refusal: str | None = None
        self.receipt: str | None = None
        self.sent = None
        self.length = 0

    def begin(self) -> None:
        """Mark the request as a write, which leaves a receipt whatever its outcome, except in a dry run."""
        self.is_write = current_dry_run.get() is None
        current_audit.set(self)

    def receipt_id(self) -> str:
        """Return the id of the receipt that the request will leave."""
        if self.receipt is None:
            self.receipt = new_identifier()
        return self.receipt

    def mark_read_only(self) -> None:
        """Mark the request as one that changes nothing, such as a query."""
        self.is_write = False

    def add_step(self, does: str, *touches: str) -> None:
        """Add a step of the write and the URLs that it affects, unless it is present already."""
        dry_run = current_dry_run.get()
        if dry_run is not None:
            dry_run.add_step(does, touches)
        if not self.plan:
            self.plan, self.touched = (does,), touches
            return
        if does not in self.plan and len(self.plan) < MAX_STEPS:
            self.plan = (*self.plan, does)
        self._touch(touches)

    def _touch(self, urls: Iterable[str]) -> None:
        if len(self.touched) < MAX_STEPS:
            self.touched = tuple(dict.fromkeys((*self.touched, *urls)))

    def add_receivers(self, matched: int) -> None:
        """Add the number of subscribers that received a message."""
        self.matched = matched + (self.matched or 0)

    def set_refusal(self, words: str, about: Sequence[str]) -> None:
        """Record the reason of a refusal, and the URLs that it mentions."""
        self.refusal = words
        self._touch(about)

    def hash_chunk(self, chunk: bytes) -> None:
        """Add a part of a streamed body to its digest."""
        if self.sent is None:
            self.sent = hashlib.sha256()
        self.sent.update(chunk)
        self.length += len(chunk)


current_audit: ContextVar[AuditContext | None] = ContextVar("under_way", default=None)
"""Audit context of the current task's write, or None."""


def record_step(does: str, *touches: str) -> None:
    """Record a step of the current write, as `AuditContext.add_step` does."""
    context = current_audit.get()
    if context is not None:
        context.add_step(does, *touches)


SCANNED = 2048
"""Maximum number of characters of a text that are scanned."""
_WORDS = (
    *("passw", "passphr", "passcode", '"pass"', "pass=", "kennwort", "pwd", "secret", "token", "bearer", "credential"),
    *("authori", "authenti", "oauth", "cookie", "csrf", "sessionid", "session_id", "psk", "-----begin "),
)
"""Lower-case names of credentials, as in the name of a field, a path or a URL parameter."""
_KEYS = re.compile(r"(?:api|access|private|secret|account|encryption|signing|shared|master|ssh|wifi|wpa)[-_ ]?key")
_WELL_KNOWN = ("ghp_", "gho_", "ghs_", "github_pat_", "glpat-", "xox", "sk-", "sk_live_", "akia", "aiza")
"""Prefixes of the keys of well-known services, in lower case."""
_SHAPES: tuple[tuple[str, re.Pattern[str]], ...] = (
    ("key", _KEYS),
    ("basic ", re.compile(r"\bbasic {1,9}[a-z0-9+/=_-]{8}")),  # HTTP authentication
    ("rosld_", re.compile(r"rosld_[\w-]{43}")),  # a token of rosld's own
    ("eyj", re.compile(r"eyj[\w-]{8,200}\.")),  # a JSON Web Token
    ("@", re.compile(r"://[^\s/@:]{0,100}:[^\s/@]{1,200}@")),  # a password in a URL
    *((each, re.compile(rf"\b{each}[\w-]{{10}}")) for each in _WELL_KNOWN),
)
"""Lower-case patterns of credentials, each with a text that all matches contain, which is searched first."""
_BARE = re.compile(r"[\s\"']*(?=\S*[0-9])(?=\S*[A-Za-z])[A-Za-z0-9+/_.~=-]{24,1024}[\s\"']*")
"""A single word of letters and digits that is unlikely to be anything but a key."""
_LONGEST_BARE = 1100
_ESCAPED = re.compile(r"\\u([0-9a-fA-F]{4})")


def holds_credentials(text: str) -> bool:
    """Whether a text appears to contain credentials, including percent-encoded ones and JSON or Turtle escapes."""
    begin = text[:SCANNED]
    if _looks_secret(begin) or (len(begin) < _LONGEST_BARE and _BARE.fullmatch(begin) is not None):
        return True
    if "\\u" in begin:
        begin = _ESCAPED.sub(lambda found: chr(int(found[1], 16)), begin)
        if _looks_secret(begin):
            return True
    return "%" in begin and _looks_secret(unquote(begin.replace("+", " ")))


def _looks_secret(text: str) -> bool:
    small = text.lower()
    for word in _WORDS:
        if word in small:
            return True
    return any(mark in small and shape.search(small) is not None for mark, shape in _SHAPES)


_MAX_TEXT = 500
"""Maximum number of characters of a step, of a refusal's reason, and of a media type."""
_LONGEST_URL = 2000
_WITHHELD = "(withheld)"
_CUT_TOKEN = re.compile(rf"{PREFIX}[\w-]*\Z")
"""Possible beginning of a token at the end of the scanned text."""


class AuditEntry(NamedTuple):
    """A request and its response. `body` is the stored part of the body, complete if `digest` (SHA-256) is None."""

    agent: Agent
    started_ns: int
    ended_ns: int
    method: str
    url: str
    query: bytes
    media_type: str | None
    body: bytes | None
    length: int
    digest: bytes | None
    plan: tuple[str, ...]
    touched: tuple[str, ...]
    matched: int | None
    status: int
    created: str | None
    words: str | None
    reason: str | None = None
    client: str | None = None


def excerpt(body: bytes) -> tuple[bytes, bytes | None]:
    """Return the stored part of a body, and its digest if that is not all."""
    return (body, None) if len(body) <= SCANNED else (body[:SCANNED], hashlib.sha256(body).digest())


def receipt_of(entry: AuditEntry, number: int, id: str, excerpt_bytes: int) -> Receipt:
    """Return the receipt without possible secrets: with a secret in the request, the outcome is withheld too."""
    query = entry.query.decode("latin-1")
    hides_query = bool(query) and holds_credentials(query)
    text = _text(entry.body) if entry.body else None
    withheld = bool(entry.body) and (holds_credentials(entry.url) or (text is not None and holds_credentials(text)))
    digest = entry.digest if withheld or entry.digest or not entry.body else hashlib.sha256(entry.body).digest()
    return Receipt(
        number,
        id,
        entry.agent.name,
        entry.agent.webid,
        entry.started_ns,
        entry.ended_ns,
        entry.method,
        _url(entry.url, _WITHHELD.strip("()") if hides_query else query),
        None if entry.media_type is None else redact_tokens(entry.media_type)[:_MAX_TEXT],
        entry.length,
        None if withheld or digest is None else f"sha-256=:{base64.b64encode(digest).decode()}:",
        None if withheld or text is None or not excerpt_bytes else _begin(text, excerpt_bytes),
        withheld or hides_query,
        tuple(dict.fromkeys(_redacted(step, withheld) for step in entry.plan[:MAX_STEPS])),
        tuple(map(redact_tokens, entry.touched[:MAX_STEPS])),
        entry.matched,
        entry.status,
        None if entry.created is None else redact_tokens(entry.created),
        None if entry.words is None else _redacted(entry.words, withheld),
        None if entry.reason is None else _redacted(entry.reason, withheld),
        None if entry.client is None else _redacted(entry.client, False),
    )


def touched_urls(
    url: str, touched: Sequence[str], created: str | None, status: int, length: int
) -> Sequence[str] | None:
    """Return the URLs that a write concerned: its own, those in its query and its steps, and that of the new resource.

    Return None if there may be more: for an update, whose WHERE may read everything; for steps too many to list; for a
    withheld query; and for a refused body that may name other things.
    """
    own, _, query = url.partition("?")
    if own.endswith("/sparql") or len(touched) >= MAX_STEPS or query == _WITHHELD.strip("()"):
        return None
    if own.endswith("/") and length and status >= 400:
        return None
    named = (urljoin(own, value) for _, value in parse_qsl(query) if value.startswith(("/", "http:", "https:")))
    return (own, *touched, *named, *(() if created is None else (created,)))


def _text(body: bytes) -> str | None:
    """Return the beginning of a body if it is UTF-8; the last character may be cut."""
    try:
        text = codecs.getincrementaldecoder("utf-8")().decode(body[:SCANNED])
    except UnicodeDecodeError:
        return None
    if len(body) > SCANNED:
        text = _CUT_TOKEN.sub("", text)
    return None if "\0" in text else text


def _begin(text: str, limit: int) -> str:
    cut = text.encode()[:limit].decode("utf-8", "ignore")
    return cut if len(cut) == len(text) else f"{cut}..."


def _redacted(words: str, withheld: bool) -> str:
    """Return a sentence unless it may contain a secret value."""
    if withheld or holds_credentials(words):
        return _WITHHELD
    return words if len(words) <= _MAX_TEXT else f"{words[:_MAX_TEXT]}..."


def _url(url: str, query: str) -> str:
    whole = f"{url}?{query}" if query else url
    return redact_tokens(whole)[:_LONGEST_URL]
