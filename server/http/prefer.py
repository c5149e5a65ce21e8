"""Preferences (RFC 7240), with the `include` and `omit` of LDP 7.2 for `return=representation`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from rosld.server.http import header_syntax as fields

Parameters = tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Preference:
    """One preference: its value ("" for none; RFC 7240 2 treats both alike) and its parameters."""

    value: str = ""
    parameters: Parameters = ()


@dataclass(frozen=True, slots=True)
class Preferences:
    """What a request prefers, by lower-case name; of a name that occurs twice the first counts (RFC 7240 2)."""

    named: Mapping[str, Preference] = field(default_factory=dict)

    def value(self, name: str) -> str | None:
        """The value of a preference in lower case, None where it is not stated."""
        found = self.named.get(name)
        return None if found is None else found.value.lower()

    @property
    def minimal(self) -> bool:
        """return=minimal (RFC 7240 4.2)."""
        return self.value("return") == "minimal"

    @property
    def representation(self) -> bool:
        """return=representation (RFC 7240 4.2)."""
        return self.value("return") == "representation"

    @property
    def wait(self) -> int | None:
        """wait=SECONDS (RFC 7240 4.3); None where it is missing or no whole number."""
        value = self.value("wait") or ""
        return int(value) if value.isascii() and value.isdigit() and len(value) < 10 else None

    @property
    def include(self) -> frozenset[str]:
        """The URIs of `include` of return=representation (LDP 7.2.2)."""
        return self._uris("include")

    @property
    def omit(self) -> frozenset[str]:
        """The URIs of `omit` of return=representation (LDP 7.2.2)."""
        return self._uris("omit")

    def _uris(self, name: str) -> frozenset[str]:
        found = self.named.get("return") if self.representation else None
        return frozenset(
            uri for key, value in (found.parameters if found else ()) if key == name for uri in value.split()
        )


NO_PREFERENCES = Preferences()


def parse(text: str | None) -> Preferences:
    """The preferences in a Prefer field. Malformed members are passed over, as a preference may always be ignored."""
    if text is None:
        return NO_PREFERENCES
    named: dict[str, Preference] = {}
    for member in fields.split(text, ","):
        try:
            name, preference = _preference(member)
        except ValueError:
            continue
        named.setdefault(name, preference)
    return Preferences(named)


def preference_applied(*names: str) -> str:
    """The value of Preference-Applied for preferences such as `return=representation` (RFC 7240 3)."""
    return fields.require_field_value(", ".join(names))


def render(preferences: Preferences) -> str:
    """The Prefer field that states these preferences. Raises ValueError for what no header can hold."""
    return ", ".join(_write(name, preference) for name, preference in preferences.named.items())


def _preference(member: str) -> tuple[str, Preference]:
    head, *rest = fields.split(member, ";")
    name, value = fields.parse_parameter(head)
    return name, Preference(value, tuple(fields.parse_parameter(part) for part in rest))


def _write(name: str, preference: Preference) -> str:
    pairs = [(name, preference.value), *preference.parameters]
    return "; ".join(_pair(key, value) for key, value in pairs)


def _pair(name: str, value: str) -> str:
    if not fields.is_token(name):
        raise ValueError(f"{name!r} is no preference name")
    return name if not value else f"{name}={value if fields.is_token(value) else fields.quote(value)}"
