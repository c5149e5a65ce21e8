"""`rosld token`: add, list and remove tokens in the file of `--auth` (TOML), which a running server reloads."""

from __future__ import annotations

import itertools
import os
import re
import tempfile
from collections.abc import Iterator, Sequence
from datetime import datetime, timezone
from pathlib import Path

import click

from rosld.server.auth import config, tokens
from rosld.server.auth.config import AuthConfig
from rosld.server.cli.failure import user_errors

_TABLE = re.compile(r"^[ \t]*\[", re.MULTILINE)
_TOKEN = re.compile(r"^[ \t]*\[\[[ \t]*token[ \t]*\]\]")


def add(file: Path, name: str, modes: Sequence[str], globs: Sequence[str]) -> None:
    """Add a token for an agent, and a rule if there are modes or globs; print the token.

    It is printed only once: the file contains its digest. Raises Failure if the file cannot be read.
    """
    token = tokens.generate_token()
    created = datetime.now(timezone.utc).strftime("%Y-%m-%d")
    more = f'\n[[token]]\nagent = {_text(name)}\nsha256 = "{tokens.token_digest(token)}"\ncreated = "{created}"\n'
    if modes or globs:
        more += (
            f"\n[[rule]]\nagents = [{_text(name)}]\nmodes = [{', '.join(map(_text, modes or ('read',)))}]\n"
            f"paths = [{', '.join(map(_text, globs or ('/**',)))}]\n"
        )
    with user_errors():
        before = _content(file)
        _write(file, before + (more if before.strip() else more.lstrip("\n")))
    click.echo(token)


def count_tokens(file: Path) -> None:
    """Print each agent with tokens, and their number. Raises Failure if the file cannot be read."""
    with user_errors():
        found = _read(file)
    counts: dict[str, int] = {}
    for agent in found.tokens.agents.values():
        counts[agent] = counts.get(agent, 0) + 1
    for agent, count in sorted(counts.items()):
        click.echo(f"{agent}\t{count}")


def remove(file: Path, name: str) -> None:
    """Remove all tokens of an agent, but not the rules that name it. Raises Failure if it has no token."""
    with user_errors():
        found = _read(file)
        if name not in found.tokens.agents.values():
            raise ValueError(f"{file}: {name!r} has no token")
        text = _content(file)
        _write(file, "".join(part for part in _parts(text) if not _is_token_of(part, name)))


def _parts(text: str) -> Iterator[str]:
    """Split the text into tables, each from its heading to the next one."""
    starts = [0, *(match.start() for match in _TABLE.finditer(text)), len(text)]
    return (text[start:end] for start, end in itertools.pairwise(starts))


def _is_token_of(part: str, name: str) -> bool:
    if not _TOKEN.match(part):
        return False
    agents = set(config.from_toml(part.encode()).tokens.agents.values())
    return agents == {name}


def _content(file: Path) -> str:
    if file.suffix in (".ttl", ".turtle"):
        raise ValueError(f"{file}: tokens can only be added to TOML; in Turtle, add ros:tokenDigest by hand")
    return file.read_text("utf-8") if file.exists() else ""


def _read(file: Path) -> AuthConfig:
    return config.read_config(file, "http://localhost/")


def _text(text: str) -> str:
    """Return a TOML string."""
    escaped = "".join(f"\\u{ord(char):04x}" if char in '"\\' or not char.isprintable() else char for char in text)
    return f'"{escaped}"'


def _write(file: Path, text: str) -> None:
    """Replace a file atomically by a valid one that only its owner can read."""
    try:
        config.from_toml(text.encode())
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error
    handle, name = tempfile.mkstemp(dir=file.absolute().parent, prefix=".auth-")
    try:
        with open(handle, "w", encoding="utf-8") as written:  # noqa: PTH123 - it is a handle
            written.write(text)
            written.flush()
            os.fsync(written.fileno())
        if file.exists():
            Path(name).chmod(file.stat().st_mode & 0o777)
        Path(name).replace(file)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
