"""Every setting of a server: its name, type, default, meaning, and option.

Settings          the values, validated on creation
setting(...)      declares one: `option` or `metavar` makes it an option of `rosld serve`; others need --setting
describe()        the table of `docs/reference/settings.md`
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple, TypeVar
from urllib.parse import urlsplit

from rosld.adapters.base import MESSAGE_LIMIT, AdapterOptions
from rosld.adapters.catalogue import NAME as CATALOGUE
from rosld.adapters.model import Qos
from rosld.server.http.origin import is_loopback, is_wildcard, normalize_origin

_V = TypeVar("_V")


def setting(
    default: _V,
    help: str,
    *,
    option: bool = False,
    unit: str = "",
    minimum: float | None = None,
    metavar: str | None = None,
    choices: tuple[str, ...] = (),
) -> _V:
    """Declare a setting; `unit` is the unit of its number, which is at least `minimum`. A `metavar` makes an option."""
    is_option = option or metavar is not None
    metadata = {"help": help, "option": is_option, "unit": unit, "minimum": minimum, "metavar": metavar}
    return dataclasses.field(default=default, metadata={**metadata, "choices": choices})


@dataclass(frozen=True, kw_only=True)
class Settings:
    """The settings of one server. Raises ValueError with a sentence for the user if they are inconsistent."""

    base_url: str = setting(
        "http://127.0.0.1:8080/",
        "The URL at which clients reach this server, the base of every IRI. Default: the address it is bound to.",
        metavar="URL",
    )
    host: str = setting(
        "127.0.0.1",
        "The address to listen on. Beyond loopback the server is read-only without --auth; a wildcard "
        "address needs --base-url.",
        metavar="ADDRESS",
    )
    port: int = setting(8080, "The port to listen on; 0 picks a free one.", metavar="PORT", minimum=0)
    auth: Path | None = setting(  # noqa: RUF009 - it is a field
        None,
        "Who may do what: agents, their tokens, rules (TOML, or Turtle with Web Access Control). Reloaded "
        "when it changes. Default: everybody may do everything.",
        metavar="FILE",
    )
    tls_cert: Path | None = setting(  # noqa: RUF009 - it is a field
        None, "The certificate (PEM, with its chain) to serve https with. Reloaded when it changes.", metavar="FILE"
    )
    tls_key: Path | None = setting(  # noqa: RUF009 - it is a field
        None, "Its private key (PEM), if it is in a separate file.", metavar="FILE"
    )
    data: Path | None = setting(  # noqa: RUF009 - it is a field
        None, "The folder to store data in. It belongs to one base URL. Default: in memory.", metavar="DIR"
    )
    subscribe: tuple[str, ...] = setting(
        (), "Topics to subscribe to permanently, such as '/camera/*'. Repeatable.", metavar="GLOB"
    )
    history: tuple[str, ...] = setting(
        (),
        "Topics to record continuously into /bags/history/, such as '*'. Stored in --data DIR, else in "
        "memory. Repeatable.",
        metavar="GLOB",
    )
    history_time: float = setting(86400.0, "How far back the history reaches.", unit="s", minimum=1, metavar="SECONDS")
    history_size: int = setting(
        0,
        "The maximum size of the history in bytes. Default (0): 1 GiB in --data DIR, 128 MiB in memory.",
        unit="bytes",
        minimum=0,
        metavar="BYTES",
    )
    allow_publish: tuple[str, ...] = setting(
        (),
        "Topics that may be published to although other nodes publish them or no node subscribes to them. "
        "Topics of ROS itself, such as /tf, only by exact name. Repeatable.",
        metavar="GLOB",
    )
    allow_non_finite: tuple[str, ...] = setting(
        (),
        "Topics, services, actions and parameters that accept any number: NaN, infinities, and values beyond "
        "the limits of commands (3.4e38, velocities 1e6). Repeatable.",
        metavar="GLOB",
    )
    stop_zero: tuple[str, ...] = setting(
        (),
        "Topics on which a stop publishes zero, in addition to those of a velocity type (Twist, "
        "TwistStamped, AckermannDrive and stamped); prefix '!' to exclude topics. Repeatable.",
        metavar="GLOB",
    )
    stop_ready: bool = setting(
        False,
        "Advertise the topics on which a stop publishes zero as soon as they have a subscriber, so that a "
        "stop need not wait for ROS to connect them. Other nodes see rosld as a publisher.",
        option=True,
    )
    stop_cancels: str = setting(
        "own",
        "The goals that a stop cancels: 'own', sent through rosld, or 'others', all goals of all actions.",
        metavar="WHOSE",
        choices=("own", "others"),
    )
    name: str = setting(
        "",
        "The name of the robot on pages and in descriptions. Default: the parameter /robot_name, the name in "
        "its URDF (robot_description), or the host name.",
        metavar="NAME",
    )
    resources_only: tuple[str, ...] = setting(
        (),
        "ROS names that can be written only through /resources/, where mappings protect them: /topics, "
        "/services and /parameters refuse them. Repeatable.",
        metavar="GLOB",
    )
    mapping: tuple[Path, ...] = setting(
        (), "A mapping document (RDF) that defines resources, relations and conditions. Repeatable.", metavar="FILE"
    )
    shapes: tuple[Path, ...] = setting(
        (), "Limits (SHACL, Turtle) on what may be written, by type or by resource. Repeatable.", metavar="FILE"
    )
    getter: tuple[str, ...] = setting(
        (),
        "A name pattern of services that read {name}, in addition to 'get_{name}' and similar ones. Repeatable.",
        metavar="TEMPLATE",
    )
    setter: tuple[str, ...] = setting(
        (),
        "A name pattern of services that write {name}, in addition to 'set_{name}' and similar ones. Repeatable.",
        metavar="TEMPLATE",
    )
    exclude_service: tuple[str, ...] = setting(
        (),
        "Services to exclude from resources, in addition to those of ROS such as '*/get_loggers'. Repeatable.",
        metavar="GLOB",
    )
    max_publish_rate: float = setting(
        100.0, "The maximum publish rate per topic, in messages per second.", unit="Hz", minimum=0.001, metavar="N"
    )
    hold_time: float = setting(
        60.0, "The longest time that `?for=` holds a topic without renewal.", unit="s", minimum=0.1
    )
    cors_origins: tuple[str, ...] = setting(
        (),
        "Origins whose pages may read and write, such as https://app.example; '*' allows all pages to read. "
        "Repeatable.",
        metavar="URL",
    )
    types: tuple[Path, ...] = setting(
        (), "A folder to search for message and service definitions (PKG/msg/X.msg). Repeatable.", metavar="DIR"
    )
    ros_ip: str | None = setting(
        None, "ROS 1: the address at which nodes of the robot reach this machine.", metavar="IP"
    )
    host_map: tuple[tuple[str, str], ...] = setting(
        (), "ROS 1: the address of a host whose name cannot be resolved. Repeatable.", metavar="NAME=IP"
    )
    qos: tuple[tuple[str, Qos], ...] = setting(
        (),
        "ROS 2: the quality of service of rosld's own publishers and subscribers on topics, the first GLOB "
        "that fits: '/scan=best_effort,volatile,depth:5'. Policies that a profile omits are adapted to the "
        "other endpoints of the topic. Repeatable.",
        metavar="GLOB=PROFILE",
    )
    store: str | None = setting(
        None, "A SPARQL 1.1 server to mirror the dataset to, at URL/query and URL/update.", metavar="URL"
    )
    store_query: str | None = setting(None, "The query endpoint of that server, if not URL/query.", metavar="URL")
    store_update: str | None = setting(None, "The update endpoint of that server, if not URL/update.", metavar="URL")
    store_rate: float = setting(
        1.0,
        "How often changes are sent to that server; of topics, only those of --subscribe.",
        unit="Hz",
        minimum=0.001,
        metavar="HZ",
    )
    store_credentials: Path | None = setting(  # noqa: RUF009 - it is a field
        None, "A file with the credentials for that server: USER:PASSWORD, or 'Bearer TOKEN'.", metavar="FILE"
    )
    default_document: str = setting(
        "data/default",
        "The document, below /data/, that updates without a graph and ?default write to.",
        metavar="PATH",
    )
    demand_if_match: bool = setting(
        False, "Refuse a PUT that replaces a document under /data/ without If-Match (428).", option=True
    )
    read_only: bool = setting(False, "Disable everything that changes the robot.", option=True)
    mcp: str = setting(
        "read",
        "What language models may do with the tools at /mcp: 'off', 'read', or 'write' (with --auth, 'read' permits "
        "what their token does). The stop is always permitted. Needs the extra mcp.",
        metavar="WHAT",
        choices=("off", "read", "write"),
    )
    mcp_approve: tuple[str, ...] = setting(
        (),
        "URL paths that language models may write to only if a person approves each write, such as "
        "'/actions/**'. Repeatable.",
        metavar="GLOB",
    )
    mcp_budget: int = setting(
        8000, "The largest JSON value in the result of a tool; the rest is cut.", unit="bytes", minimum=500
    )
    faults: str = setting(
        "all",
        "What to follow at /faults/: 'all', or 'quiet', which subscribes to nothing and so leaves out diagnostics and "
        "the log.",
        metavar="WHAT",
        choices=("all", "quiet"),
    )
    log_format: str = setting(
        "text",
        "The format of the log: 'text', or 'json', an object a line, which also logs every request.",
        metavar="FORMAT",
        choices=("text", "json"),
    )
    rate: float = setting(1.0, "Recordings: playback speed; 1 is as recorded.", minimum=0.000001, metavar="X")
    once: bool = setting(False, "Recordings: play once and stay at the end, instead of looping.", option=True)
    first_value_wait: float = setting(
        1.0, "How long the first read of a topic, also by a query, waits for a message.", unit="s", minimum=0
    )
    idle_time: float = setting(60.0, "How long a subscription is kept after the last read.", unit="s", minimum=0)
    subscription_budget: int = setting(
        2000, "The maximum number of subscriptions; the least recently used is dropped first.", minimum=1
    )
    publish_wait: float = setting(
        0.5, "How long a publish waits for a subscriber to connect before returning 202.", unit="s", minimum=0
    )
    call_deadline: float = setting(
        10.0, "How long to wait for a service before returning 504.", unit="s", minimum=0.001
    )
    freshness: float = setting(1.0, "How long the value of a getter or a parameter is cached.", unit="s", minimum=0)
    read_deadline: float = setting(
        5.0, "How long a resource waits for the values of all its members in total.", unit="s", minimum=0.001
    )
    calls_age: float = setting(3600.0, "How long a call is kept under /calls/.", unit="s", minimum=1)
    goals_age: float = setting(
        3600.0, "How long a goal is kept under /goals/ after its last update.", unit="s", minimum=1
    )
    client_rate: float = setting(
        200.0,
        "The maximum request rate per second of one client: an agent, else an address. Without "
        "--limit-loopback, this and the next two limits apply on this machine only to agents.",
        unit="Hz",
        minimum=0.001,
    )
    client_requests: int = setting(
        64, "The maximum number of concurrent requests of one client, including streams.", minimum=1
    )
    client_connections: int = setting(256, "The maximum number of concurrent connections from one address.", minimum=1)
    limit_loopback: bool = setting(False, "Apply the limits of clients to this machine, too.", option=True)
    client_websockets: int = setting(
        256, "The maximum number of WebSockets from one address, including this machine.", minimum=1
    )
    client_streams: int = setting(
        256,
        "The maximum number of event streams and waiting requests from one address, including this machine.",
        minimum=1,
    )
    connections: int = setting(
        3000, "The maximum number of connections; a new one replaces an idle one, or gets 503.", minimum=10
    )
    head_timeout: float = setting(
        20.0, "How long a client has to send the request line and headers.", unit="s", minimum=0.01
    )
    body_timeout: float = setting(
        30.0, "How long a client has to send a body; for an uploaded file, each part of it.", unit="s", minimum=0.01
    )
    versions: int = setting(
        0,
        "The number of former versions kept of each document under /data/ and each cockpit (RDF, not files).",
        option=True,
        minimum=0,
    )
    receipts_kept: int = setting(
        10_000,
        "The maximum number of receipts of writes kept under /activity/, plus a fifth as many of refused writes.",
        minimum=1,
    )
    receipts_age: float = setting(
        30 * 24 * 3600.0, "How long the receipt of a write is kept under /activity/.", unit="s", minimum=1
    )
    receipt_excerpt: int = setting(
        500, "How much of the beginning of a body a receipt contains; 0 for none.", unit="bytes", minimum=0
    )
    body_limit: int = setting(10 * 1024 * 1024, "The largest request body.", unit="bytes", minimum=1024)
    upload_limit: int = setting(
        1024 * 1024 * 1024,
        "The largest file stored under /data/, or uploaded to /bags/, decompressed.",
        unit="bytes",
        minimum=1024,
    )
    upload_index_limit: int = setting(
        256 * 1024 * 1024,
        "The maximum memory of the index of an uploaded recording: 40 bytes per message.",
        unit="bytes",
        minimum=1024 * 1024,
    )
    message_limit: int = setting(
        MESSAGE_LIMIT,
        "The longest message or response accepted from a ROS 1 node; a longer one closes the connection.",
        unit="bytes",
        minimum=1024 * 1024,
    )
    inline_limit: int = setting(
        64 * 1024,
        "The largest array or string included inline; larger ones are replaced by a link to their bytes.",
        unit="bytes",
        minimum=0,
    )
    store_time_limit: float = setting(
        30.0, "The time limit of a request to the server of --store.", unit="s", minimum=0.1
    )
    query_time_limit: float = setting(10.0, "The time limit of a SPARQL query.", unit="s", minimum=0.001)
    query_memory_limit: int = setting(
        1024 * 1024 * 1024,
        "The memory limit of a SPARQL query beyond the dataset; enforced on Linux.",
        unit="bytes",
        minimum=16 * 1024 * 1024,
    )
    query_row_limit: int = setting(
        1_000_000,
        "The maximum number of rows, or triples of a graph, in the result of a SPARQL query.",
        minimum=1,
        metavar="N",
    )
    allow_service: tuple[str, ...] = setting(
        (), "The full URL of an endpoint that queries may use with SERVICE. Default: none. Repeatable.", metavar="URL"
    )
    allow_load: tuple[str, ...] = setting(
        (), "The full URL of a document that updates may LOAD. Default: none. Repeatable.", metavar="URL"
    )
    metrics_topics: int = setting(500, "The maximum number of topics in /metrics.", minimum=0)
    query_concurrency: int = setting(4, "The maximum number of concurrent SPARQL queries.", minimum=1)
    query_queue: int = setting(256, "The maximum number of queued SPARQL queries; further ones get 503.", minimum=0)
    types_namespace: str = setting(
        "https://w3id.org/rosld/types/", "The namespace of the classes and properties of message types."
    )

    def __post_init__(self) -> None:
        _check_base(self.base_url)
        _check_namespace(self.types_namespace)
        for declared in declarations():
            _check_value(declared, getattr(self, declared.name))
        for glob in self.mcp_approve:
            _check_path_glob("--mcp-approve", glob)
        if self.port > 65535:
            raise ValueError(f"--port {self.port}: must be at most 65535")
        _check_document(self.default_document)
        for name in ("history", "subscribe", "allow_publish", "allow_non_finite", "stop_zero"):
            for glob in getattr(self, name):
                check_topic_glob(_option(name), glob.removeprefix("!") if name == "stop_zero" else glob)
        for origin in self.cors_origins:
            _check_origin(origin)
        for option, url in (
            *(("--allow-service", url) for url in self.allow_service),
            *(("--allow-load", url) for url in self.allow_load),
        ):
            if not _is_web_url(url):
                raise ValueError(f"{option} {url}: must be an http or https URL, such as https://example.org/sparql")
        if self.tls_key is not None and self.tls_cert is None:
            raise ValueError(f"--tls-key {self.tls_key}: needs a certificate: give --tls-cert")
        _check_store(self)

    @property
    def store_endpoints(self) -> tuple[str, str] | None:
        """The query and update endpoints of the server of --store; None without one."""
        if self.store is None and self.store_query is None:
            return None
        begin = (self.store or "").rstrip("/")
        return self.store_query or f"{begin}/query", self.store_update or f"{begin}/update"

    @property
    def beyond_loopback(self) -> bool:
        """Whether other machines can reach this server at the address it listens on."""
        return not is_loopback(self.host)

    @property
    def open_beyond_loopback(self) -> bool:
        """Whether other machines can reach this server without any rules for access."""
        return self.beyond_loopback and self.auth is None

    @property
    def adapter_options(self) -> AdapterOptions:
        """The settings for adapters."""
        return AdapterOptions(
            types=self.types,
            ros_ip=self.ros_ip,
            host_map=dict(self.host_map),
            qos=self.qos,
            rate=self.rate,
            once=self.once,
            message_limit=self.message_limit,
            catalogue=None if self.data is None else self.data / CATALOGUE,
        )


class Declaration(NamedTuple):
    """A setting as declared: its name, type (as written), default and description."""

    name: str
    type: str
    default: object
    help: str
    option: str | None
    unit: str
    minimum: float | None
    metavar: str | None
    choices: tuple[str, ...]


@cache
def declarations() -> tuple[Declaration, ...]:
    """Return every setting in the order of declaration."""
    return tuple(
        Declaration(
            one.name,
            str(one.type),
            one.default,
            **{**one.metadata, "option": _option(one.name) if one.metadata["option"] else None},
        )
        for one in dataclasses.fields(Settings)
    )


def _option(name: str) -> str:
    return "--cors-origin" if name == "cors_origins" else "--" + name.replace("_", "-")


def parse(name: str, text: str) -> int | float | str:
    """Return the value of a setting without its own option, from the text after `--setting NAME`. Raises ValueError."""
    plain = {one.name: one for one in declarations() if one.option is None}
    declared = plain.get(name.replace("-", "_"))
    if declared is None:
        raise ValueError(f"unknown setting {name!r}; choose from {', '.join(sorted(plain))}")
    kinds: dict[str, type[int] | type[float] | type[str]] = {"int": int, "float": float, "str": str}
    try:
        value = kinds[declared.type](text)
    except ValueError as error:
        raise ValueError(f"the setting {name} must be a number, not {text!r}") from error
    _check_value(declared, value)
    return value


def bound(settings: Settings, port: int, *, base_given: bool) -> Settings:
    """Return the settings once the port is known: the base follows the address unless it is given.

    Beyond loopback the server is read-only unless it has rules for who may write. Raises ValueError for a wildcard
    address without a base URL.
    """
    if is_wildcard(settings.host) and not base_given:
        raise ValueError(f"--host {settings.host} is a wildcard address: give the URL for clients with --base-url")
    base = settings.base_url if base_given else address(settings.host, port, secure=settings.tls_cert is not None)
    return dataclasses.replace(
        settings, base_url=base, port=port, read_only=settings.read_only or settings.open_beyond_loopback
    )


def address(host: str, port: int, *, secure: bool = False) -> str:
    """Return the base URL of an address to listen on."""
    name = f"[{host.strip('[]')}]" if ":" in host else host
    scheme, usual = ("https", 443) if secure else ("http", 80)
    return f"{scheme}://{name}/" if port == usual else f"{scheme}://{name}:{port}/"


def canonical_base(url: str) -> str:
    """Return a base URL with a trailing slash. Raises ValueError for an invalid one."""
    base = url if url.endswith("/") else url + "/"
    _check_base(base)
    return base


def describe() -> str:
    """Return the settings as a Markdown table for `docs/reference/settings.md`."""
    rows = "".join(_row(one) for one in declarations())
    return (
        "# Settings\n\nPass these to `rosld serve`: by their option, or without one as `--setting NAME VALUE`; as an "
        "environment variable\n`ROSLD_<SETTING>`; or by name in the file of `--config` "
        "([how](../how-to/configure.md)). An option precedes the environment,\nthe environment the file, and the file "
        "the default.\nThis page is generated by `python -m rosld.server.settings > docs/reference/settings.md`.\n\n"
        "| setting | option | default | meaning |\n|---|---|---|---|\n" + rows
    )


def _row(one: Declaration) -> str:
    option = "" if one.option is None else f"`{one.option}{' ' + one.metavar if one.metavar else ''}`"
    default = {"()": "none", "None": "none", "False": "off"}.get(str(one.default), f"`{one.default}`")
    return f"| `{one.name}` | {option} | {default}{' ' + one.unit if one.unit else ''} | {one.help} |\n"


def _check_value(declared: Declaration, value: object) -> None:
    name, choices = declared.option or f"--setting {declared.name}", declared.choices
    if choices and value not in choices:
        raise ValueError(f"{name} {value}: must be {', '.join(choices[:-1])} or {choices[-1]}")
    least = declared.minimum
    if least is not None and isinstance(value, (int, float)) and not least <= value < float("inf"):
        raise ValueError(f"{name} {value}: must be at least {least:g}")


def check_topic_glob(option: str, glob: str) -> None:
    """Raise ValueError for a glob that matches no topic: names of topics begin with a slash."""
    if not glob.startswith(("/", "*")):
        raise ValueError(f"{option} {glob}: must begin with a slash or a star, such as /odom or '*'")


def _check_path_glob(option: str, glob: str) -> None:
    if not glob.startswith("/") or set(glob) & set("?#[]"):
        raise ValueError(f"{option} {glob}: must be a path below the base, such as '/topics/**'")


_UNFIT = frozenset(' <>"{}|\\^`')


def _is_web_url(url: str) -> bool:
    try:
        parts = urlsplit(url)
        _ = parts.port  # reading it raises ValueError for a bad one
        return parts.scheme in ("http", "https") and bool(parts.hostname) and not _UNFIT & set(url)
    except ValueError:
        return False


def _is_prefix(url: str) -> bool:
    """Whether paths can be added to a URL."""
    return _is_web_url(url) and url.isascii() and url.isprintable() and "?" not in url and "#" not in url


def _check_base(url: str) -> None:
    if not _is_prefix(url) or "@" in urlsplit(url).netloc:
        raise ValueError(f"--base-url {url!r} is not an http(s) URL such as http://robot.example:8080/")
    if not url.endswith("/"):
        raise ValueError(f"--base-url {url!r} must end in a slash")


def _check_store(settings: Settings) -> None:
    given = {
        "--store": settings.store,
        "--store-query": settings.store_query,
        "--store-update": settings.store_update,
    }
    for option, url in given.items():
        if url is not None:
            _check_endpoint(option, url)
    if settings.store is None and (settings.store_query is None) != (settings.store_update is None):
        raise ValueError("--store-query and --store-update must be given together, or with --store")
    if settings.store_endpoints is None and settings.store_credentials is not None:
        raise ValueError("--store-credentials needs --store")


def _check_endpoint(option: str, url: str) -> None:
    if "@" in urlsplit(url).netloc:
        raise ValueError(f"{option}: the URL is shown to others, so pass credentials with --store-credentials")
    if not _is_prefix(url):
        raise ValueError(f"{option} {url!r} is not an http(s) URL such as http://store.example:7878")


def _check_namespace(iri: str) -> None:
    if not urlsplit(iri).scheme or iri[-1] not in "/#" or _UNFIT & set(iri):
        raise ValueError(f"--setting types_namespace {iri!r} must be an IRI that ends in / or #")


def _check_document(path: str) -> None:
    if not path.startswith("data/") or path.endswith("/") or "?" in path or "#" in path:
        raise ValueError(f"--default-document {path!r} must be the path of a document, such as data/default")


def _check_origin(origin: str) -> None:
    try:
        normalize_origin(origin)
    except ValueError as error:
        raise ValueError(f"--cors-origin {origin!r} is not an origin such as https://app.example") from error


if __name__ == "__main__":
    print(describe(), end="")
