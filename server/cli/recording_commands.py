"""Commands about recordings: `rosld info`, `ls`, `query` and `cut`, and the completion of all commands."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from rosld.adapters.base import AdapterOptions
from rosld.adapters.catalogue import NAME as CATALOGUE
from rosld.server.cli.options import DEFAULT_BASE, FOLDER, GlobCommand, output_option, setting_options, settings_of

_F = TypeVar("_F", bound=Callable[..., Any])
_JSON = click.option("--json", "as_json", is_flag=True, help="Print JSON.")
_EXISTING = click.Path(exists=True, path_type=Path)


def _topics(help: str) -> Callable[[_F], _F]:
    return click.option("--topic", "topics", multiple=True, metavar="GLOB", help=help)


def _period(command: _F) -> _F:
    """Add the options --from and --to."""
    words = "an xsd:dateTime, seconds after the start (60), or before the end (-60)"
    command = click.option("--to", "until", metavar="TIME", help="The last time, in the same form.")(command)
    return click.option("--from", "since", metavar="TIME", help=f"The first time: {words}.")(command)


@click.command(cls=GlobCommand, short_help="Describe the content of recordings.")
@click.argument("files", nargs=-1, required=True, type=click.Path(), metavar="FILE...")
@_topics("Topics to describe; default: all. Repeatable.")
@_period
@_JSON
@setting_options("types")
def info(
    files: tuple[str, ...],
    topics: tuple[str, ...],
    since: str | None,
    until: str | None,
    types: tuple[Path, ...],
    *,
    as_json: bool,
) -> None:
    """Describe the content of each FILE: format, size, duration, start, end, topics with their types, counts and rates.

    \b
    Examples:
      rosld info run.bag
      rosld info run.mcap --from 60 --to 90 --topic '/camera/*'
      rosld info runs/*.mcap --json
    """
    from rosld.server.cli.info import info as run

    run(files, topics, {"from": since, "to": until}, AdapterOptions(types=types), as_json=as_json)


@click.command("ls", cls=GlobCommand, short_help="List the recordings in folders.")
@click.argument("folders", nargs=-1, type=_EXISTING, metavar="[FOLDER]...")
@click.option("--where", metavar="CONDITION", help="Only those with messages for which this is true; see above.")
@_topics("Only those with a topic of this name; repeated: with all of them.")
@_JSON
@setting_options("types")
def ls(
    folders: tuple[Path, ...], where: str | None, topics: tuple[str, ...], types: tuple[Path, ...], *, as_json: bool
) -> None:
    """List the recordings in each FOLDER (default: this one) and below: .bag, .mcap, .db3 and rosbag2 folders.

    One FOLDER keeps their summaries in .rosld.sqlite, as for `rosld serve`, so that the next listing is quick.

    A CONDITION is TOPIC.FIELD OP NUMBER, or several joined by `and`: each must be true for some message of the
    recording, not necessarily the same one. OP is one of < <= = != >= >.

    \b
    Examples:
      rosld ls runs
      rosld ls runs --where 'battery_state.percentage < 0.2 and odom.twist.twist.linear.x > 1' --json
    """
    from rosld.server.cli.ls import list_recordings

    list_recordings(folders or (Path(),), where, topics, AdapterOptions(types=types), as_json=as_json)


@click.command("index", cls=GlobCommand, short_help="Make the statistics of recordings.")
@click.argument("paths", nargs=-1, required=True, type=_EXISTING, metavar="FOLDER|FILE...")
@click.option("--data", type=FOLDER, metavar="DIR", help="The --data of the server; default: none.")
@click.option("--workers", type=click.IntRange(min=1), metavar="N", help="Number of processes; default: one per core.")
@setting_options("types")
def index(paths: tuple[Path, ...], data: Path | None, workers: int | None, types: tuple[Path, ...]) -> None:
    """Catalogue the recordings below each FOLDER, and make their statistics: what `rosld serve FOLDER` does meanwhile.

    With them a server answers questions such as the least battery of each recording without reading messages. They are
    kept with the catalogue, in the first folder or in DIR. What is indexed already is not read again.

    \b
    Examples:
      rosld index runs
      rosld index runs more --data /var/lib/rosld --workers 2
    """
    from rosld.server.cli.index import index as run

    catalogue = None if data is None else data / CATALOGUE
    run(paths, AdapterOptions(types=types, catalogue=catalogue), workers)


@click.command(short_help="Answer a SPARQL query over a source or a server.")
@click.argument("source", type=click.Path())
@click.argument("text", metavar="SPARQL|@FILE")
@click.option(
    "--format",
    type=click.Choice(["table", "csv", "tsv", "json", "parquet", "arrow"]),
    help="Default: a table on a terminal, else csv. Graphs are Turtle, or JSON-LD with json.",
)
@click.option("--base-url", default=DEFAULT_BASE, show_default=True, metavar="URL", help="The base of all URLs.")
@click.option("--setting", "others", nargs=2, multiple=True, metavar="NAME VALUE", help="Any other setting; see serve.")
@setting_options("types")
def query(
    source: str,
    text: str,
    format: str | None,
    base_url: str,
    others: tuple[tuple[str, str], ...],
    types: tuple[Path, ...],
) -> None:
    """Answer a query as /sparql of a server on SOURCE does; @FILE reads it from a file, @- from stdin.

    SOURCE is that of `rosld serve`, which is opened for this query, or the URL of a running server. The environment
    variable ROSLD_TOKEN holds the access token for a server, if any.

    \b
    Examples:
      rosld query run.bag 'SELECT (COUNT(*) AS ?n) { <topics/odom> ros:past ?m }'
      rosld query http://127.0.0.1:8080/ @question.rq --format json
    """
    from rosld.server.cli.query import TIME_LIMIT
    from rosld.server.cli.query import query as run

    run(source, text, format, settings_of((("query_time_limit", TIME_LIMIT), *others), base_url, types=types))


@click.command(cls=GlobCommand, short_help="Cut out a part of a recording, or the parts around events.")
@click.argument("recording", type=click.Path())
@output_option("Where to write: x.mcap, x.bag (a ROS 1 bag), a name without a suffix (a ROS 2 bag), or - (MCAP).")
@_topics("Topics to cut out; default: all. Repeatable.")
@_period
@click.option(
    "--around", multiple=True, metavar="EVENT", help="A time, a SPARQL query, @FILE, or a condition. Repeatable."
)
@click.option("--before", type=click.FloatRange(min=0), default=5.0, show_default=True, metavar="SECONDS")
@click.option("--after", type=click.FloatRange(min=0), default=5.0, show_default=True, metavar="SECONDS")
@setting_options("types")
def cut(
    recording: str,
    output: Path,
    topics: tuple[str, ...],
    since: str | None,
    until: str | None,
    around: tuple[str, ...],
    before: float,
    after: float,
    types: tuple[Path, ...],
) -> None:
    """Write the messages of RECORDING between two times, or around events, to FILE.

    The cut stands alone: it begins with the latched messages in force at its start, such as /tf_static. Events are at a
    time (as in --from), at the times in the first column of a query that has only values of xsd:dateTime, and where a
    condition such as `battery_state.percentage < 0.2` becomes true. Several events are written to FILE-1, FILE-2 and so
    on; those whose seconds before and after overlap are one.

    \b
    Examples:
      rosld cut run.bag -o part.bag --from 60 --to 90 --topic /odom --topic '/camera/*'
      rosld cut run.mcap -o low.mcap --around 'battery_state.percentage < 0.2' --before 10
      rosld cut run.mcap -o fault.mcap --around @faults.rq
    """
    from rosld.server.cli.cut import cut as run

    run(recording, output, topics, {"from": since, "to": until}, around, (before, after), AdapterOptions(types=types))


@click.command(short_help="Print the completion script of a shell.")
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
@click.pass_context
def completion(context: click.Context, shell: str) -> None:
    """Print the script with which a shell completes the commands and options of rosld.

    \b
    Examples:
      rosld completion bash >> ~/.bashrc
      rosld completion zsh >> ~/.zshrc
      rosld completion fish > ~/.config/fish/completions/rosld.fish
    """
    from click.shell_completion import get_completion_class

    found = get_completion_class(shell)
    assert found is not None
    click.echo(found(context.find_root().command, {}, "rosld", "_ROSLD_COMPLETE").source())


COMMANDS = (info, ls, index, query, cut, completion)
