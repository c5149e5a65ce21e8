"""The command line: `rosld serve`, `guard`, `lift`, `token`, `dump` and others, each in its own module."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

import rosld
from rosld.adapters.base import AdapterOptions
from rosld.adapters.model import Qos
from rosld.server import settings as declared
from rosld.server.cli import conversion_commands
from rosld.server.cli.failure import EXIT_CODES, CommandGroup, Failure, user_errors
from rosld.server.cli.options import (
    FILE,
    FOLDER,
    GlobCommand,
    output_option,
    setting_options,
    settings_of,
    source_argument,
)
from rosld.server.cli.recording_commands import COMMANDS
from rosld.server.cli.tables import json_text


@click.group(
    cls=CommandGroup,
    epilog=EXIT_CODES,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)
@click.version_option(rosld.__version__, prog_name="rosld", message="%(prog)s %(version)s")
def main() -> None:
    """rosld puts a robot on the web: a cockpit to drive it, a URL for everything, and SPARQL.

    \b
    Examples:
      rosld serve aircraft                 an embedded aircraft to try things on
      rosld serve rover                    an embedded mobile robot: drive it, send it somewhere
      rosld serve run.bag                  a recording, played in a loop
      rosld serve ros1://localhost:11311   a live ROS 1 system
      rosld serve rosbridge://robot:9090   a robot behind rosbridge
      rosld serve zenoh://robot:7447       a ROS 2 system with rmw_zenoh
      rosld info run.bag                   what a recording contains
      rosld ls runs --where 'battery_state.percentage < 0.2'
      rosld query run.bag 'SELECT ...'     SPARQL over a recording
      rosld cut run.bag -o part.mcap --from 60 --to 90
      rosld lift run.bag -o run.nq.gz      a whole recording as RDF
      rosld export recordings/ -o tables   recordings as Parquet
      rosld types run.bag                  the message types in it
      rosld mcp rover                      tools for a language model, on stdin and stdout
      rosld check ros1:                    what would work, what not, and why
      rosld guard ros2: --data DIR         end the holds on DIR when its rosld is killed
      rosld token add anna --file a.toml   a token for a user of a server with --auth
      rosld dump DIR -o data.tar.gz        a copy of stored resources; restore it with rosld load

    A SOURCE is `aircraft`, `rover`, the path of a recording (.bag, .mcap, .db3, a rosbag2 folder) or of a folder of
    recordings, `ros1://HOST:PORT` (`ros1:` takes ROS_MASTER_URI), `ros2:?domain=42&namespace=/robot1` (`ros2:` takes
    ROS_DOMAIN_ID), or a bridge: `foxglove://HOST:8765`, `rosbridge://HOST:9090`, `zenoh://HOST:7447`.
    """
    if os.name != "posix":
        raise Failure("The server forks its workers, which needs a POSIX system: use Linux, or WSL on Windows.")


def _others() -> str:
    """Return the settings without an option, as text for the help."""
    rows = (
        f"  {one.name} ({one.default}{' ' + one.unit if one.unit else ''})"
        for one in declared.declarations()
        if not one.option
    )
    about = (
        "The environment may give each setting, too (ROSLD_PORT for --port; spaces separate the items of lists, colons "
        "files and folders), and so may the file of --config, by name. An option precedes the environment, and the "
        "environment the file."
    )
    return f"{about}\n\n\b\nWith --setting NAME VALUE (and their defaults):\n" + "\n".join(rows)


@main.command(cls=GlobCommand, epilog=_others())
@source_argument()
@setting_options()
def serve(source: str, others: tuple[tuple[str, str], ...], base_url: str | None, **options: Any) -> None:
    """Serve SOURCE on the web: a robot, a recording, or all recordings of folders, files and globs.

    Several robots, each as NAME=SOURCE, are below /robots/NAME/.

    Listens once the source is open, then prints one line, the URL of the start page. Exits on Ctrl-C, SIGTERM, SIGQUIT,
    and SIGHUP unless that is ignored (nohup).

    \b
    Examples:
      rosld serve aircraft --port 0
      rosld serve run.mcap --rate 0.5 --subscribe '/camera/*'
      rosld serve runs/ more/ 'old/*.bag'
      rosld serve anna=ros1://anna:11311 ben=ros2:?domain=7
      rosld serve ros1://robot:11311 --ros-ip 10.0.0.7 --allow-publish /cmd_vel
      rosld serve ros1: --host 0.0.0.0 --base-url http://robot.example:8080/
    """
    settings = settings_of(others, base_url, **options)
    from rosld.server.cli.serve import serve as run

    run(source, settings, base_given=base_url is not None)


@main.command(cls=GlobCommand, short_help="Say what would work with SOURCE, and what not and why.")
@source_argument(required=False)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@setting_options()
def check(
    source: str | None,
    others: tuple[tuple[str, str], ...],
    base_url: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Look at SOURCE and at this machine, and say what would work, what not, why, and what to do.

    Takes the options of `rosld serve`. The robot is only read: a few topics with stamps are subscribed to for a moment.
    Exits with the code with which `rosld serve` would fail. Without SOURCE, only the file of --config is checked.

    \b
    Examples:
      rosld check ros2:?domain=42
      rosld check ros1://robot:11311 --ros-ip 10.0.0.7 --data /var/lib/rosld
      rosld check --config rosld.toml
    """
    settings = settings_of(others, base_url, **options)
    context = click.get_current_context()
    origin = context.get_parameter_source("source")
    if source is None or origin not in (ParameterSource.COMMANDLINE, ParameterSource.ENVIRONMENT):
        if not context.default_map:
            raise click.UsageError("Give a SOURCE, --config FILE, or both", context)
        click.echo(json_text({"findings": []}) if as_json else "ok  the settings are valid")
        return
    from rosld.server.cli.check import check as run

    context.exit(run(source, settings, base_given=base_url is not None, as_json=as_json))


@main.command("mcp", cls=GlobCommand, short_help="Serve SOURCE to a language model, on stdin and stdout.")
@source_argument()
@setting_options()
def mcp(source: str, others: tuple[tuple[str, str], ...], base_url: str | None, **options: Any) -> None:
    """Serve SOURCE to a language model: tools of the Model Context Protocol on stdin and stdout.

    The source is opened here, with the options of `rosld serve`, and listens nowhere. The URL of a running server as
    SOURCE connects to that instead. The environment variable ROSLD_TOKEN holds the access token of the model, if any.

    \b
    Examples:
      rosld mcp rover --mcp write
      rosld mcp http://127.0.0.1:8080/
    """
    settings = settings_of(others, base_url, **options)
    from rosld.server.cli.mcp import serve_tools

    serve_tools(source, settings)


@main.command(cls=GlobCommand, short_help="Record live topics of SOURCE into FILE.")
@click.argument("source", default="ros2:")
@output_option("Where to write: x.mcap, x.bag (a ROS 1 bag), a name without a suffix (a ROS 2 bag), or - (MCAP).")
@click.option("--topic", "topics", multiple=True, metavar="GLOB", help="Topics to record; default: all. Repeatable.")
@click.option("--duration", type=click.FloatRange(min=0), metavar="SECONDS", help="Stop after this time.")
@setting_options("types", "ros_ip", "host_map", "qos")
def record(
    source: str,
    output: Path,
    topics: tuple[str, ...],
    duration: float | None,
    types: tuple[Path, ...],
    ros_ip: str | None,
    host_map: tuple[tuple[str, str], ...],
    qos: tuple[tuple[str, Qos], ...],
) -> None:
    """Record live topics of SOURCE (default ros2:) into FILE, until Ctrl-C or for --duration seconds.

    FILE.mcap is written as MCAP, FILE.bag as a ROS 1 bag for rosbag, and a name without a suffix as the folder of a
    ROS 2 bag for ros2 bag. The output appears under its name once it is complete; - writes MCAP to a pipe.

    \b
    Examples:
      rosld record ros1://localhost:11311 -o run.bag
      rosld record ros2: -o drive.mcap --topic /odom --topic '/camera/*' --duration 60
    """
    from rosld.server.cli.record import record as run

    run(source, output, topics, duration, AdapterOptions(types=types, ros_ip=ros_ip, host_map=dict(host_map), qos=qos))


@main.command(short_help="End the holds of a rosld that was killed.")
@click.argument("source", type=click.Path())
@click.option("--data", "folder", required=True, type=FOLDER, metavar="DIR", help="The --data of the rosld to watch.")
@click.option("--once", is_flag=True, help="Exit once nothing is left to do: for systemd's ExecStopPost.")
@setting_options("types", "ros_ip", "host_map", "qos")
def guard(
    source: str,
    folder: Path,
    once: bool,
    types: tuple[Path, ...],
    ros_ip: str | None,
    host_map: tuple[tuple[str, str], ...],
    qos: tuple[tuple[str, Qos], ...],
) -> None:
    """Watch the rosld that serves SOURCE with --data DIR; when it dies, publish the final messages of its holds.

    A rosld that exits normally leaves no holds. Runs alongside rosld until Ctrl-C or SIGTERM.

    \b
    Examples:
      rosld guard ros1://localhost:11311 --data /var/lib/rosld
      rosld guard ros2: --data /var/lib/rosld --once
    """
    from rosld.server.cli.guard import guard as run

    run(source, folder, AdapterOptions(types=types, ros_ip=ros_ip, host_map=dict(host_map), qos=qos), once=once)


@main.command(short_help="List the message and service types of SOURCE.")
@click.argument("source", type=click.Path())
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@setting_options("types")
def types(source: str, types: tuple[Path, ...], *, as_json: bool) -> None:
    """List the message and service types that SOURCE uses: name, tab, hash.

    \b
    Examples:
      rosld types run.bag
      rosld types ros1://localhost:11311
    """
    from rosld.server.cli.list_types import types as run

    run(source, AdapterOptions(types=types), as_json=as_json)


@main.group(short_help="Manage tokens for a server with --auth.")
def token() -> None:
    """Create, list and remove tokens in the file of `rosld serve --auth FILE`, which rereads it when it changes.

    \b
    Examples:
      rosld token add anna --mode read --glob '/topics/**' --file auth.toml
      rosld token list --file auth.toml
      rosld token remove anna --file auth.toml
    """


_AUTH = click.option("--file", required=True, type=click.Path(dir_okay=False, path_type=Path), metavar="FILE")


@token.command("add", short_help="Create a token for NAME and print it once.")
@click.argument("name")
@click.option(
    "--mode",
    "modes",
    multiple=True,
    type=click.Choice(["read", "write", "control", "administer"]),
    help="What NAME may do. Repeatable; default with --glob: read.",
)
@click.option("--glob", "globs", multiple=True, metavar="GLOB", help="Where, such as '/topics/**'. Repeatable.")
@_AUTH
def token_add(name: str, modes: tuple[str, ...], globs: tuple[str, ...], file: Path) -> None:
    """Create a token for NAME and print it once: only its digest is stored.

    Without --mode and --glob the rules are unchanged.
    """
    from rosld.server.cli.manage_tokens import add

    add(file, name, modes, globs)


@token.command("list", short_help="List agents and their number of tokens.")
@_AUTH
def token_list(file: Path) -> None:
    """List agents with tokens: name, tab, number of tokens."""
    from rosld.server.cli.manage_tokens import count_tokens

    count_tokens(file)


@token.command("remove", short_help="Remove all tokens of NAME.")
@click.argument("name")
@_AUTH
def token_remove(name: str, file: Path) -> None:
    """Remove all tokens of NAME. A server that uses FILE rejects them within a second or two."""
    from rosld.server.cli.manage_tokens import remove

    remove(file, name)


@main.command(short_help="Copy the stored resources of DIR into a file.")
@click.argument("folder", metavar="DIR", type=click.Path(exists=True, file_okay=False, path_type=Path))
@output_option("Where to write: a .tar.gz.")
def dump(folder: Path, output: Path) -> None:
    """Copy the stored resources, RDF and files, of DIR (`rosld serve --data DIR`) into FILE.

    The copy is a consistent snapshot, even while a server runs on DIR. FILE appears only once it is complete.

    \b
    Examples:
      rosld dump /var/lib/rosld -o monday.tar.gz
    """
    from rosld.server.cli.dump_load import dump as run

    run(folder, output)


@main.command(short_help="Restore a dump into DIR.")
@click.argument("file", type=FILE)
@click.argument("folder", metavar="DIR", type=FOLDER)
@click.option("--base-url", default=None, metavar="URL", help="The new base of IRIs that begin with the dump's base.")
def load(file: Path, folder: Path, base_url: str | None) -> None:
    """Replace all stored resources of DIR by those of FILE, atomically.

    A server may run on DIR: it continues with the content of FILE. Resources that are not in FILE are deleted; deleted
    ones that are in FILE are restored. DIR belongs to the base URL of the dump, unless --base-url rewrites its IRIs
    (those in RDF; files are unchanged).

    \b
    Examples:
      rosld load monday.tar.gz /var/lib/rosld
      rosld load monday.tar.gz new --base-url https://data.example/
    """
    from rosld.server.cli.dump_load import load as run

    with user_errors():
        base = None if base_url is None else declared.canonical_base(base_url)
    run(file, folder, base)


for command in (*COMMANDS, *conversion_commands.COMMANDS):
    main.add_command(command)
