"""Media types (RFC 9110 8.3.1): read, compare, write."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from rosld.server.http import header_syntax


@dataclass(frozen=True, slots=True)
class MediaType:
    """A media type or range: type and subtype in lower case, parameters sorted by their lower-case names.

    The value of `charset` is in lower case too, being case-insensitive (RFC 9110 8.3.2).
    """

    type: str
    subtype: str
    parameters: tuple[tuple[str, str], ...] = ()

    @property
    def essence(self) -> str:
        """`type/subtype` without parameters."""
        return f"{self.type}/{self.subtype}"

    def parameter(self, name: str) -> str | None:
        """The value of a parameter, None where it is missing."""
        return dict(self.parameters).get(name) if self.parameters else None

    def __str__(self) -> str:
        return self.essence + "".join(
            f";{name}={value if header_syntax.is_token(value) else header_syntax.quote(value)}"
            for name, value in self.parameters
        )


@lru_cache(maxsize=256)
def parse(text: str) -> MediaType:
    """The media type in `text`, such as a Content-Type. Raises ValueError naming what is wrong."""
    essence, *rest = header_syntax.split(text, ";") or [""]
    kind, slash, subtype = essence.partition("/")
    if not slash or not header_syntax.is_token(kind) or not header_syntax.is_token(subtype):
        raise ValueError(f"{text!r} is no media type; one looks like text/turtle")
    parameters: dict[str, str] = {}
    for part in rest:
        name, value = header_syntax.parse_parameter(part)
        if name in parameters:
            raise ValueError(f"the parameter {name!r} occurs twice in {text!r}")
        parameters[name] = value.lower() if name == "charset" else value
    return MediaType(kind.lower(), subtype.lower(), tuple(sorted(parameters.items())))
