"""Every setting of a server, once: its name, type, default, what it means, and how it is given.

Settings          the values, checked when made
setting(...)      declares one: `option` is its own option of `rosld serve`; the others are given with --setting
describe()        the table of `docs/reference/settings.md`
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, TypeVar
from urllib.parse import urlsplit

from rosld.adapters.base import MESSAGE_LIMIT, AdapterOptions
from rosld.adapters.model import Qos
from rosld.server.http.origin import is_loopback, is_wildcard, normalize_origin

_V = TypeVar("_V")
_HELP, _OPTION, _UNIT, _MINIMUM, _METAVAR = "help", "option", "unit", "minimum", "metavar"


def setting(
    default: _V,
    help: str,
    *,
    option: bool = False,
    unit: str = "",
    minimum: float | None = None,
    metavar: str | None = None,
) -> _V:
    """Declare a setting; `unit` is the unit of its number, which is at least `minimum`."""
    metadata = {_HELP: help, _OPTION: option, _UNIT: unit, _MINIMUM: minimum, _METAVAR: metavar}
    return dataclasses.field(default=default, metadata=metadata)


@dataclass(frozen=True, kw_only=True)
class Settings:
    """The settings of one server. Raises ValueError with a sentence for the user if they are inconsistent."""

    base_url: str = setting(
        "http://127.0.0.1:8080/",
        "The URL under which clients reach this server: it begins every IRI. Default: the address it is bound to.",
        option=True,
        metavar="URL",
    )
    host: str = setting(
        "127.0.0.1",
        "The address to listen on. Beyond loopback the server is read-only unless --auth says who may write; a "
        "wildcard address needs --base-url.",
        option=True,
        metavar="ADDRESS",
    )
    port: int = setting(8080, "The port to listen on; 0 takes a free one.", option=True, metavar="PORT", minimum=0)
    auth: Path | None = setting(  # noqa: RUF009 - it is a field
        None,
        "Who may do what: agents, their tokens, rules (TOML, or Turtle with Web Access Control). It is read again "
        "whenever it changes. Default: everybody may do everything.",
        option=True,
        metavar="FILE",
    )
    tls_cert: Path | None = setting(  # noqa: RUF009 - it is a field
        None, "The certificate (PEM, with its chain) to serve https with.", option=True, metavar="FILE"
    )
    tls_key: Path | None = setting(  # noqa: RUF009 - it is a field
        None, "Its private key (PEM), if it is in a file of its own.", option=True, metavar="FILE"
    )
    data: Path | None = setting(  # noqa: RUF009 - it is a field
        None, "The folder to keep data in. It belongs to one base URL. Default: in memory.", option=True, metavar="DIR"
    )
    subscribe: tuple[str, ...] = setting(
        (), "Topics to subscribe to at once and always, such as '/camera/*'. Repeatable.", option=True, metavar="GLOB"
    )
    history: tuple[str, ...] = setting(
        (),
        "Topics to record all the time, such as '*'; the recording is /bags/history/. In --data DIR, else in memory. "
        "Repeatable.",
        option=True,
        metavar="GLOB",
    )
    history_time: float = setting(
        86400.0, "How much of the past the history holds.", option=True, unit="s", minimum=1, metavar="SECONDS"
    )
    history_size: int = setting(
        0,
        "The most bytes of the history. Default (0): 1 GiB in --data DIR, 128 MiB in memory.",
        option=True,
        unit="bytes",
        minimum=0,
        metavar="BYTES",
    )
    allow_publish: tuple[str, ...] = setting(
        (),
        "Topics that may be published to although other nodes publish them, or none subscribes to them. /tf and the "
        "like only by their exact name. Repeatable.",
        option=True,
        metavar="GLOB",
    )
    allow_non_finite: tuple[str, ...] = setting(
        (),
        "Topics, services, actions and parameters that are sent any number: NaN, infinities, and what is larger than a "
        "command may be (3.4e38, velocities 1e6). Repeatable.",
        option=True,
        metavar="GLOB",
    )
    stop_zero: tuple[str, ...] = setting(
        (),
        "Topics on which a stop publishes zero, beside those that command velocities by their type (Twist, "
        "TwistStamped, AckermannDrive and stamped); with '!' before it, topics that it leaves alone. Repeatable.",
        option=True,
        metavar="GLOB",
    )
    stop_ready: bool = setting(
        False,
        "Advertise the topics on which a stop publishes zero as soon as they have a subscriber, not when the robot is "
        "stopped: a stop need not wait until ROS has connected them. Other nodes see rosld as a publisher.",
        option=True,
    )
    stop_cancels: str = setting(
        "own",
        "The goals that a stop cancels: 'own', sent through rosld, or 'others', all goals of all actions.",
        option=True,
        metavar="WHOSE",
    )
    name: str = setting(
        "",
        "What pages and descriptions call the robot; else the parameter /robot_name, the name in its URDF "
        "(robot_description), or that of its machine.",
        option=True,
        metavar="NAME",
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
        100.0, "The most publishes a second to one topic.", option=True, unit="Hz", minimum=0.001, metavar="N"
    )
    hold_time: float = setting(
        60.0, "The longest time that `?for=` holds a topic without its being renewed.", unit="s", minimum=0.1
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
    qos: tuple[tuple[str, Qos], ...] = setting(
        (),
        "ROS 2: the quality of service of rosld's own publishers and subscribers on topics, the first GLOB that fits: "
        "'/scan=best_effort,volatile,depth:5'. What a profile leaves out fits the others on the topic. Repeatable.",
        option=True,
        metavar="GLOB=PROFILE",
    )
    store: str | None = setting(
        None,
        "A SPARQL 1.1 server that is told everything the dataset holds, at URL/query and URL/update.",
        option=True,
        metavar="URL",
    )
    store_query: str | None = setting(
        None, "Where that server is queried, if elsewhere than at URL/query.", option=True, metavar="URL"
    )
    store_update: str | None = setting(
        None, "Where that server is updated, if elsewhere than at URL/update.", option=True, metavar="URL"
    )
    store_rate: float = setting(
        1.0,
        "How often that server is told what changed: of topics, those subscribed to by --subscribe.",
        option=True,
        unit="Hz",
        minimum=0.001,
        metavar="HZ",
    )
    store_credentials: Path | None = setting(  # noqa: RUF009 - it is a field
        None,
        "A file that holds what that server demands: USER:PASSWORD, or 'Bearer TOKEN'.",
        option=True,
        metavar="FILE",
    )
    default_document: str = setting(
        "data/default",
        "The document, below /data/, that is written where an update or ?default names no graph.",
        option=True,
        metavar="PATH",
    )
    demand_if_match: bool = setting(
        False, "Refuse a PUT that replaces a document under /data/ without If-Match (428).", option=True
    )
    read_only: bool = setting(False, "Offer nothing that changes the robot.", option=True)
    rate: float = setting(
        1.0, "Recordings: how fast to play, 1 being as recorded.", option=True, minimum=0.000001, metavar="X"
    )
    once: bool = setting(False, "Recordings: play once and rest at the end, instead of in a loop.", option=True)
    first_value_wait: float = setting(
        1.0, "How long the first look at a topic, a query's too, waits for a message.", unit="s", minimum=0
    )
    idle_time: float = setting(60.0, "How long a subscription is kept after the last look.", unit="s", minimum=0)
    subscription_budget: int = setting(
        2000, "The most subscriptions at a time; the longest unused goes first.", minimum=1
    )
    publish_wait: float = setting(
        0.5, "How long a publish waits for a subscriber to connect before it answers 202.", unit="s", minimum=0
    )
    call_deadline: float = setting(
        10.0, "How long to wait for a service before answering 504.", unit="s", minimum=0.001
    )
    freshness: float = setting(
        1.0, "How long the value of a getter or a parameter is shown before it is read again.", unit="s", minimum=0
    )
    read_deadline: float = setting(
        5.0, "How long a resource waits for the values of all its members together.", unit="s", minimum=0.001
    )
    calls_age: float = setting(3600.0, "How long a call is kept under /calls/.", unit="s", minimum=1)
    goals_age: float = setting(
        3600.0, "How long a goal is kept under /goals/ after it was last heard of.", unit="s", minimum=1
    )
    client_rate: float = setting(
        200.0,
        "The most requests a second of one client: of an agent, else of an address. On this machine only agents are "
        "held to it, and to the two that follow, unless --limit-loopback is given.",
        unit="Hz",
        minimum=0.001,
    )
    client_requests: int = setting(64, "The most requests of one client at a time, streams included.", minimum=1)
    client_connections: int = setting(256, "The most connections from one address at a time.", minimum=1)
    limit_loopback: bool = setting(False, "Hold clients on this machine to the limits of clients, too.", option=True)
    client_websockets: int = setting(
        256, "The most WebSockets from one address at a time, from this machine, too.", minimum=1
    )
    client_streams: int = setting(
        256,
        "The most event streams and waiting requests from one address at a time, from this machine, too.",
        minimum=1,
    )
    connections: int = setting(
        3000,
        "The most connections at a time; a new one takes the place of an idle one, or is answered 503.",
        minimum=10,
    )
    head_timeout: float = setting(
        20.0, "How long a client has to send the request line and headers.", unit="s", minimum=0.01
    )
    body_timeout: float = setting(
        30.0,
        "How long a client has to send a body; a file that is to be kept, each part of it.",
        unit="s",
        minimum=0.01,
    )
    versions: int = setting(
        0,
        "How many former versions of each document under /data/ and each cockpit are kept (RDF, not files).",
        option=True,
        minimum=0,
    )
    receipts_kept: int = setting(
        10_000, "The most receipts of writes kept under /activity/; of refused ones a fifth as many beside.", minimum=1
    )
    receipts_age: float = setting(
        30 * 24 * 3600.0, "How long the receipt of a write is kept under /activity/.", unit="s", minimum=1
    )
    receipt_excerpt: int = setting(
        500, "How much of its beginning a receipt tells of a body; 0: nothing.", unit="bytes", minimum=0
    )
    body_limit: int = setting(10 * 1024 * 1024, "The largest request body.", unit="bytes", minimum=1024)
    upload_limit: int = setting(
        1024 * 1024 * 1024,
        "The largest file that is kept under /data/, or sent to /bags/, inflated.",
        unit="bytes",
        minimum=1024,
    )
    upload_index_limit: int = setting(
        256 * 1024 * 1024,
        "The most memory that the index of a recording which is sent may take: 40 bytes a message.",
        unit="bytes",
        minimum=1024 * 1024,
    )
    message_limit: int = setting(
        MESSAGE_LIMIT,
        "The longest message or response that is read from a node of ROS 1; a longer one ends the connection.",
        unit="bytes",
        minimum=1024 * 1024,
    )
    inline_limit: int = setting(
        64 * 1024,
        "The largest array or string told inline; a larger one is elided, with a link to its bytes.",
        unit="bytes",
        minimum=0,
    )
    store_time_limit: float = setting(
        30.0, "The longest one request to the server of --store may take.", unit="s", minimum=0.1
    )
    query_time_limit: float = setting(10.0, "The longest a SPARQL query may take.", unit="s", minimum=0.001)
    query_memory_limit: int = setting(
        1024 * 1024 * 1024,
        "The most memory a SPARQL query may take beyond the dataset; held on Linux.",
        unit="bytes",
        minimum=16 * 1024 * 1024,
    )
    query_row_limit: int = setting(
        1_000_000,
        "The most rows, or triples of a graph, in the answer to a SPARQL query.",
        option=True,
        minimum=1,
        metavar="N",
    )
    allow_service: tuple[str, ...] = setting(
        (),
        "An endpoint that queries may ask by SERVICE, as its whole URL. Default: none. Repeatable.",
        option=True,
        metavar="URL",
    )
    allow_load: tuple[str, ...] = setting(
        (),
        "A document that updates may take in by LOAD, as its whole URL. Default: none. Repeatable.",
        option=True,
        metavar="URL",
    )
    query_concurrency: int = setting(4, "The most SPARQL queries that are answered at a time.", minimum=1)
    query_queue: int = setting(
        256, "The most SPARQL queries that wait for their turn; to more the answer is 503.", minimum=0
    )
    types_namespace: str = setting(
        "https://w3id.org/rosld/types/", "The namespace of the classes and properties of message types."
    )

    def __post_init__(self) -> None:
        _check_base(self.base_url)
        _check_namespace(self.types_namespace)
        for declared in declarations():
            _check_minimum(declared, getattr(self, declared.name))
        if self.stop_cancels not in ("own", "others"):
            raise ValueError(f"--stop-cancels {self.stop_cancels}: it is own or others")
        if self.port > 65535:
            raise ValueError(f"--port {self.port}: a port is at most 65535")
        _check_document(self.default_document)
        for glob in self.history:
            check_topic_glob("--history", glob)
        for glob in self.subscribe:
            check_topic_glob("--subscribe", glob)
        for glob in self.allow_publish:
            check_topic_glob("--allow-publish", glob)
        for glob in self.allow_non_finite:
            check_topic_glob("--allow-non-finite", glob)
        for glob in self.stop_zero:
            check_topic_glob("--stop-zero", glob.removeprefix("!"))
        for origin in self.cors_origins:
            _check_origin(origin)
        for url in self.allow_service:
            _check_asked("--allow-service", url)
        for url in self.allow_load:
            _check_asked("--allow-load", url)
        if self.tls_key is not None and self.tls_cert is None:
            raise ValueError(f"--tls-key {self.tls_key}: its certificate is missing: give --tls-cert")
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


_OPTIONS = {"cors_origins": "--cors-origin"}


def declarations() -> tuple[Declaration, ...]:
    """Return every setting in the order of declaration."""
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
            one.metadata[_MINIMUM],
            one.metadata[_METAVAR],
        )


_DECLARATIONS = tuple(_declarations())


def parse(name: str, text: str) -> int | float | str:
    """Return the value of a setting without its own option, from the text after `--setting NAME`. Raises ValueError."""
    plain = {one.name: one for one in declarations() if one.option is None}
    declared = plain.get(name.replace("-", "_"))
    if declared is None:
        raise ValueError(f"there is no setting {name!r}; there are {', '.join(sorted(plain))}")
    kinds: dict[str, type[int] | type[float] | type[str]] = {"int": int, "float": float, "str": str}
    try:
        value = kinds[declared.type](text)
    except ValueError as error:
        raise ValueError(f"the setting {name} takes a number, not {text!r}") from error
    _check_minimum(declared, value)
    return value


def bound(settings: Settings, port: int, *, base_given: bool) -> Settings:
    """Return the settings once the port is known: the base follows the address unless it is given.

    Beyond loopback the server is read-only unless it has rules for who may write. Raises ValueError for a wildcard
    address without a base URL.
    """
    if is_wildcard(settings.host) and not base_given:
        raise ValueError(f"--host {settings.host} stands for every address: say with --base-url how clients reach it")
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
        "# Settings\n\n"
        "Those with an option are given to `rosld serve` by it, the others with `--setting NAME VALUE`.\n"
        "This page is written by `python -m rosld.server.settings > docs/reference/settings.md`.\n\n"
        "| setting | option | default | what it means |\n|---|---|---|---|\n" + rows
    )


def _row(one: Declaration) -> str:
    option = "" if one.option is None else f"`{one.option}{' ' + one.metavar if one.metavar else ''}`"
    default = {"()": "none", "None": "none", "False": "off"}.get(str(one.default), f"`{one.default}`")
    return f"| `{one.name}` | {option} | {default}{' ' + one.unit if one.unit else ''} | {one.help} |\n"


def _check_minimum(declared: Declaration, value: object) -> None:
    if declared.minimum is None or not isinstance(value, (int, float)):
        return
    if not declared.minimum <= value < float("inf"):
        name = declared.option or f"--setting {declared.name}"
        raise ValueError(f"{name} {value}: must be at least {declared.minimum:g}")


def check_topic_glob(option: str, glob: str) -> None:
    """Raise ValueError for a glob that matches no topic: names of topics begin with a slash."""
    if not glob.startswith(("/", "*")):
        raise ValueError(f"{option} {glob}: a topic or a glob begins with a slash or a star, such as /odom or '*'")


def _check_asked(option: str, url: str) -> None:
    parts = urlsplit(url)
    if parts.scheme not in ("http", "https") or not parts.hostname or set(url) & set(' <>"{}|\\^`'):
        raise ValueError(f"{option} {url}: this is no URL of http or https, such as https://example.org/sparql")


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
        raise ValueError("--store-query and --store-update go together, unless --store says where the other is")
    if settings.store_endpoints is None and settings.store_credentials is not None:
        raise ValueError("--store-credentials are for the server of --store, and there is none")


def _check_endpoint(option: str, url: str) -> None:
    parts = urlsplit(url)
    if "@" in parts.netloc:
        raise ValueError(f"{option}: a URL is shown to others, so give what the server demands by --store-credentials")
    try:
        sound = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        sound = False
    if not sound or "?" in url or "#" in url or not url.isascii() or not url.isprintable() or _UNFIT & set(url):
        raise ValueError(f"{option} {url!r} is no http(s) URL such as http://store.example:7878")


_UNFIT = frozenset(' <>"{}|\\^`')


def _check_namespace(iri: str) -> None:
    if not urlsplit(iri).scheme or iri[-1] not in "/#" or any(char in ' <>"{}|\\^`' for char in iri):
        raise ValueError(f"--setting types_namespace {iri!r} must be an IRI that ends in / or #")


def _check_document(path: str) -> None:
    if not path.startswith("data/") or path.endswith("/") or "?" in path or "#" in path:
        raise ValueError(f"--default-document {path!r} must be the path of a document, such as data/default")


def _check_origin(origin: str) -> None:
    try:
        normalize_origin(origin)
    except ValueError as error:
        raise ValueError(f"--cors-origin {origin!r} is no origin such as https://app.example") from error


if __name__ == "__main__":
    print(describe(), end="")
