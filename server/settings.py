"""Every setting of a server, once: its name, type, default, what it means, and how it is given.

Settings          the values, checked when made
setting(...)      declares one: `option` is its own option of `rosld serve`; the others are given with --setting
describe()        the table of `docs/settings.md`
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, TypeVar
from urllib.parse import urlsplit

from rosld.adapters.base import AdapterOptions
from rosld.server.http.origin import is_loopback, is_wildcard, normal_origin

_V = TypeVar("_V")
_HELP, _OPTION, _UNIT, _LEAST, _METAVAR = "help", "option", "unit", "least", "metavar"


def setting(
    default: _V,
    help: str,
    *,
    option: bool = False,
    unit: str = "",
    least: float | None = None,
    metavar: str | None = None,
) -> _V:
    """Declares a setting; `unit` belongs to its number, which is at least `least`."""
    metadata = {_HELP: help, _OPTION: option, _UNIT: unit, _LEAST: least, _METAVAR: metavar}
    return dataclasses.field(default=default, metadata=metadata)


@dataclass(frozen=True, kw_only=True)
class Settings:
    """The settings of one server. Raises ValueError with a sentence for the user where they make no sense."""

    base_url: str = setting(
        "http://127.0.0.1:8080/",
        "The URL under which clients reach this server: it begins every IRI. Default: the address it is bound to.",
        option=True,
        metavar="URL",
    )
    host: str = setting(
        "127.0.0.1",
        "The address to listen on. Beyond loopback the server is read-only; a wildcard address needs --base-url.",
        option=True,
        metavar="ADDRESS",
    )
    port: int = setting(8080, "The port to listen on; 0 takes a free one.", option=True, metavar="PORT", least=0)
    data: Path | None = setting(  # noqa: RUF009 - it is a field
        None, "The folder to keep data in. It belongs to one base URL. Default: in memory.", option=True, metavar="DIR"
    )
    subscribe: tuple[str, ...] = setting(
        (), "Topics to subscribe to at once and always, such as '/camera/*'. Repeatable.", option=True, metavar="GLOB"
    )
    allow_publish: tuple[str, ...] = setting(
        (),
        "Topics that may be published to although other nodes publish them. /tf and the like only by their exact name. "
        "Repeatable.",
        option=True,
        metavar="GLOB",
    )
    resources_only: tuple[str, ...] = setting(
        (),
        "ROS names that are written under /resources/ only, where mappings guard them: /topics, /services and "
        "/parameters refuse them. Repeatable.",
        option=True,
        metavar="GLOB",
    )
    mapping: tuple[Path, ...] = setting(
        (),
        "A mapping document (RDF): it arranges resources, names relations, gives conditions. Repeatable.",
        option=True,
        metavar="FILE",
    )
    shapes: tuple[Path, ...] = setting(
        (),
        "Limits (SHACL, Turtle) on what may be written, by type or by resource. Repeatable.",
        option=True,
        metavar="FILE",
    )
    getter: tuple[str, ...] = setting(
        (),
        "A name of services that read {name}, beside 'get_{name}' and the like. Repeatable.",
        option=True,
        metavar="TEMPLATE",
    )
    setter: tuple[str, ...] = setting(
        (),
        "A name of services that write {name}, beside 'set_{name}' and the like. Repeatable.",
        option=True,
        metavar="TEMPLATE",
    )
    exclude_service: tuple[str, ...] = setting(
        (),
        "Services that are in no resource, beside ROS's own such as '*/get_loggers'. Repeatable.",
        option=True,
        metavar="GLOB",
    )
    max_publish_rate: float = setting(
        100.0, "The most publishes a second to one topic.", option=True, unit="Hz", least=0.001, metavar="N"
    )
    cors_origins: tuple[str, ...] = setting(
        (),
        "Origins whose pages may read and write, such as https://app.example; '*' lets every page read. Repeatable.",
        option=True,
        metavar="URL",
    )
    types: tuple[Path, ...] = setting(
        (),
        "A folder to look for message and service definitions in (PKG/msg/X.msg). Repeatable.",
        option=True,
        metavar="DIR",
    )
    ros_ip: str | None = setting(
        None, "ROS 1: the address that nodes of the robot reach this machine by.", option=True, metavar="IP"
    )
    host_map: tuple[tuple[str, str], ...] = setting(
        (), "ROS 1: the address of a host whose name does not resolve here. Repeatable.", option=True, metavar="NAME=IP"
    )
    demand_if_match: bool = setting(
        False, "Refuse to change what is kept under /data/ without If-Match (428).", option=True
    )
    read_only: bool = setting(False, "Offer nothing that changes the robot.", option=True)
    rate: float = setting(
        1.0, "Recordings: how fast to play, 1 being as recorded.", option=True, least=0.000001, metavar="X"
    )
    once: bool = setting(False, "Recordings: play once and rest at the end, instead of in a loop.", option=True)
    first_value_wait: float = setting(1.0, "How long the first look at a topic waits for a message.", unit="s", least=0)
    idle_time: float = setting(60.0, "How long a subscription is kept after the last look.", unit="s", least=0)
    subscription_budget: int = setting(
        2000, "The most subscriptions at a time; the longest unused goes first.", least=1
    )
    publish_wait: float = setting(
        0.5, "How long a publish waits for a subscriber to connect before it answers 202.", unit="s", least=0
    )
    call_deadline: float = setting(10.0, "How long to wait for a service before answering 504.", unit="s", least=0.001)
    freshness: float = setting(
        1.0, "How long the value of a getter or a parameter is shown before it is read again.", unit="s", least=0
    )
    read_deadline: float = setting(
        5.0, "How long a resource waits for the values of all its members together.", unit="s", least=0.001
    )
    calls_kept: int = setting(1000, "The most calls kept under /calls/; the oldest goes first.", least=1)
    calls_age: float = setting(3600.0, "How long a call is kept under /calls/.", unit="s", least=1)
    body_limit: int = setting(10 * 1024 * 1024, "The largest request body.", unit="bytes", least=1024)
    upload_limit: int = setting(
        1024 * 1024 * 1024, "The largest file that is kept under /data/.", unit="bytes", least=1024
    )
    inline_limit: int = setting(
        64 * 1024,
        "The largest array or string told inline; a larger one is elided, with a link to its bytes.",
        unit="bytes",
        least=0,
    )
    query_time_limit: float = setting(10.0, "The longest a SPARQL query may take.", unit="s", least=0.001)
    query_memory_limit: int = setting(
        1024 * 1024 * 1024,
        "The most memory a SPARQL query may take beyond the dataset; held on Linux.",
        unit="bytes",
        least=16 * 1024 * 1024,
    )
    query_size_limit: int = setting(256 * 1024, "The longest text of a SPARQL query.", unit="bytes", least=1024)
    types_namespace: str = setting(
        "https://w3id.org/rosld/types/", "The namespace of the classes and properties of message types."
    )

    def __post_init__(self) -> None:
        _check_base(self.base_url)
        _check_namespace(self.types_namespace)
        for declared in declarations():
            _check_least(declared, getattr(self, declared.name))
        if self.port > 65535:
            raise ValueError(f"--port {self.port}: a port is at most 65535")
        for origin in self.cors_origins:
            _check_origin(origin)

    @property
    def beyond_loopback(self) -> bool:
        """Whether other machines can reach this server by the address it listens on."""
        return not is_loopback(self.host)

    @property
    def adapter_options(self) -> AdapterOptions:
        """The settings that concern adapters."""
        return AdapterOptions(
            types=self.types,
            ros_ip=self.ros_ip,
            host_map=dict(self.host_map),
            rate=self.rate,
            once=self.once,
        )


class Declaration(NamedTuple):
    """A setting as declared: its name, type (as written), default and meaning."""

    name: str
    type: str
    default: object
    help: str
    option: str | None
    unit: str
    least: float | None
    metavar: str | None


_OPTIONS = {"cors_origins": "--cors-origin"}


def declarations() -> tuple[Declaration, ...]:
    """Every setting in the order of its declaration."""
    return _DECLARATIONS


def _declarations() -> Iterator[Declaration]:
    for one in dataclasses.fields(Settings):
        option = _OPTIONS.get(one.name, "--" + one.name.replace("_", "-")) if one.metadata[_OPTION] else None
        default = one.default
        yield Declaration(
            one.name,
            str(one.type),
            default,
            one.metadata[_HELP],
            option,
            one.metadata[_UNIT],
            one.metadata[_LEAST],
            one.metadata[_METAVAR],
        )


_DECLARATIONS = tuple(_declarations())


def parse(name: str, text: str) -> int | float | str:
    """The value of a setting that is no option of its own, from the text after `--setting NAME`. Raises ValueError."""
    plain = {one.name: one for one in declarations() if one.option is None}
    declared = plain.get(name.replace("-", "_"))
    if declared is None:
        raise ValueError(f"there is no setting {name!r}; there are {', '.join(sorted(plain))}")
    kinds: dict[str, type[int] | type[float] | type[str]] = {"int": int, "float": float, "str": str}
    try:
        value = kinds[declared.type](text)
    except ValueError as error:
        raise ValueError(f"the setting {name} takes a number, not {text!r}") from error
    _check_least(declared, value)
    return value


def bound(settings: Settings, port: int, *, base_given: bool) -> Settings:
    """The settings once the port is known: the base follows the address unless it was given.

    Beyond loopback the server is read-only. Raises ValueError for a wildcard address without a base URL.
    """
    if is_wildcard(settings.host) and not base_given:
        raise ValueError(f"--host {settings.host} stands for every address: say with --base-url how clients reach it")
    base = settings.base_url if base_given else address(settings.host, port)
    return dataclasses.replace(
        settings, base_url=base, port=port, read_only=settings.read_only or settings.beyond_loopback
    )


def address(host: str, port: int) -> str:
    """The base URL of an address to listen on."""
    name = f"[{host.strip('[]')}]" if ":" in host else host
    return f"http://{name}/" if port == 80 else f"http://{name}:{port}/"


def canonical_base(url: str) -> str:
    """A base URL with the slash at its end. Raises ValueError for what cannot be one."""
    base = url if url.endswith("/") else url + "/"
    _check_base(base)
    return base


def describe() -> str:
    """The settings as a Markdown table: what `docs/settings.md` holds."""
    rows = "".join(_row(one) for one in declarations())
    return (
        "# Settings\n\n"
        "Those with an option are given to `rosld serve` by it, the others with `--setting NAME VALUE`.\n"
        "This page is written by `python -m rosld.server.settings > docs/settings.md`.\n\n"
        "| setting | option | default | what it means |\n|---|---|---|---|\n" + rows
    )


def _row(one: Declaration) -> str:
    option = "" if one.option is None else f"`{one.option}{' ' + one.metavar if one.metavar else ''}`"
    default = {"()": "none", "None": "none", "False": "off"}.get(str(one.default), f"`{one.default}`")
    return f"| `{one.name}` | {option} | {default}{' ' + one.unit if one.unit else ''} | {one.help} |\n"


def _check_least(declared: Declaration, value: object) -> None:
    if declared.least is None or not isinstance(value, (int, float)):
        return
    if not declared.least <= value < float("inf"):
        name = declared.option or f"--setting {declared.name}"
        raise ValueError(f"{name} {value}: must be at least {declared.least:g}")


def _check_base(url: str) -> None:
    parts = urlsplit(url)
    try:
        port: int | Literal["bad"] | None = parts.port
    except ValueError:
        port = "bad"
    sound = parts.scheme in ("http", "https") and parts.hostname and port != "bad" and parts.username is None
    if not sound or parts.query or parts.fragment or not url.isascii() or any(char in ' <>"{}|\\^`' for char in url):
        raise ValueError(f"--base-url {url!r} is no http(s) URL such as http://robot.example:8080/")
    if not url.endswith("/"):
        raise ValueError(f"--base-url {url!r} must end in a slash")


def _check_namespace(iri: str) -> None:
    if not urlsplit(iri).scheme or iri[-1] not in "/#" or any(char in ' <>"{}|\\^`' for char in iri):
        raise ValueError(f"--setting types_namespace {iri!r} must be an IRI that ends in / or #")


def _check_origin(origin: str) -> None:
    try:
        normal_origin(origin)
    except ValueError as error:
        raise ValueError(f"--cors-origin {origin!r} is no origin such as https://app.example") from error


if __name__ == "__main__":
    print(describe(), end="")
