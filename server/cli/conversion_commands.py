"""Commands that convert recordings in parallel: `rosld lift` and `rosld export`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from rosld.adapters.model.moment import Moment, parse_moment
from rosld.server import settings as declared
from rosld.server.cli.failure import ExitCode, user_errors
from rosld.server.cli.options import DEFAULT_BASE, GlobCommand, setting_options
from rosld.server.settings import Settings

_F = TypeVar("_F", bound=Callable[..., Any])


def _moment(context: click.Context, parameter: click.Parameter, value: str | None) -> Moment | None:
    try:
        return None if value is None else parse_moment(parameter.opts[0].strip("-"), value)
    except ValueError as error:
        raise click.BadParameter(str(error)) from error


def _conversion(command: _F) -> _F:
    """Add the arguments and options of all conversions."""
    for decorate in reversed(
        (
            click.argument("recordings", nargs=-1, required=True, metavar="RECORDING..."),
            click.option("--topic", "topics", multiple=True, metavar="GLOB", help="Topics; default: all. Repeatable."),
            click.option("--from", "begin", callback=_moment, metavar="TIME", help="The first time; see above."),
            click.option("--to", "end", callback=_moment, metavar="TIME", help="The last time."),
            click.option(
                "--workers", type=click.IntRange(1), metavar="N", help="Worker processes; default: one per core."
            ),
            click.option("--dask", metavar="ADDRESS", help="Use the workers of a Dask scheduler (tcp://HOST:8786)."),
            setting_options("types"),
        )
    ):
        command = decorate(command)
    return command


@click.command(cls=GlobCommand, short_help="Turn recordings into RDF.")
@click.option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Where to write: .nq, .nt, .ttl or .trig, each also with .gz; - for stdout.",
)
@click.option("--into", metavar="URL", help="Send it to this store instead: Graph Store Protocol, in N-Quads.")
@click.option("--graph", metavar="IRI", help="With --into: everything in this graph, in N-Triples.")
@click.option("--token", envvar="ROSLD_TOKEN", metavar="TOKEN", help="With --into: a bearer token.")
@click.option("--format", default="nq", show_default=True, metavar="SUFFIX", help="The format of stdout.")
@click.option("--base-url", default=DEFAULT_BASE, show_default=True, metavar="URL", help="The base of all URLs.")
@click.option(
    "--inline-limit",
    type=click.IntRange(0),
    default=Settings.inline_limit,
    show_default=True,
    metavar="BYTES",
    help="Replace larger arrays and strings by their length and the URL of their bytes.",
)
@_conversion
def lift(
    recordings: tuple[str, ...],
    output: Path | None,
    into: str | None,
    graph: str | None,
    token: str | None,
    format: str,
    topics: tuple[str, ...],
    begin: Moment | None,
    end: Moment | None,
    workers: int | None,
    dask: str | None,
    base_url: str,
    inline_limit: int,
    types: tuple[Path, ...],
) -> None:
    """Turn whole RECORDINGs into RDF.

    A RECORDING is a file, a rosbag2 folder, another folder (with every recording below it), or a URL such as
    s3://BUCKET/run.mcap (rosld[files]). Each message gets its own URL (BASE/bags/NAME/messages/K) and, in .nq and
    .trig, a named graph of that name. TIME is an xsd:dateTime, or seconds after the start of each recording (60), or
    before its end (-60).

    FILE appears only once it is complete. After an interruption, the same command continues. A store receives requests
    of about a megabyte, each repeated if the store is busy; USER:PASSWORD may stand in its URL.

    \b
    Examples:
      rosld lift run.bag -o run.nq
      rosld lift run.mcap -o run.trig.gz --base-url https://data.example/
      rosld lift recordings/ -o all.nq.gz --topic /odom --from -60 --workers 8
      rosld lift run.mcap --into http://localhost:7878/store
    """
    from rosld.ontology.lift import LiftSettings
    from rosld.server.cli.lift import LiftJob, target
    from rosld.server.cli.lift import lift as run
    from rosld.server.cli.recording_inputs import Selection
    from rosld.server.cli.store_upload import UploadJob, destination, upload

    if (output is None) == (into is None):
        raise click.UsageError("Give either -o FILE or --into URL.")
    selection, settings = Selection(topics, begin, end), LiftSettings(inline_limit=inline_limit)
    with user_errors(ExitCode.USAGE):
        base = declared.canonical_base(base_url)
        if output is not None:
            wanted = target(f"stdout.{format}" if str(output) == "-" else str(output))
            job = LiftJob(selection=selection, base=base, settings=settings, target=wanted)
        else:
            url, authorization = destination(str(into), graph, token)
            wanted = target("x.nq" if graph is None else "x.nt")
            sending = UploadJob(
                selection=selection, base=base, settings=settings, target=wanted, url=url, authorization=authorization
            )
    if output is not None:
        run(recordings, types, job, output, workers, dask)
    else:
        upload(recordings, types, sending, workers, dask)


@click.command(cls=GlobCommand, short_help="Turn recordings into tables: Parquet, Arrow, CSV.")
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="The folder to write into.",
)
@click.option("--format", default="parquet", show_default=True, type=click.Choice(["parquet", "arrow", "csv"]))
@_conversion
def export(
    recordings: tuple[str, ...],
    output: Path,
    format: str,
    topics: tuple[str, ...],
    begin: Moment | None,
    end: Moment | None,
    workers: int | None,
    dask: str | None,
    types: tuple[Path, ...],
) -> None:
    """Turn RECORDINGs into tables, one per topic and recording: DIR/topic=odom/run=NAME/part-0.parquet.

    A row is a message, a column a field (twist.twist.linear.x); rosld[parquet] is needed. RECORDING and TIME are those
    of rosld lift. Files of the same topics and recordings are replaced, others in DIR remain. After an interruption,
    the same command continues.

    \b
    Examples:
      rosld export recordings/ -o tables
      rosld export s3://fleet/monday/ -o tables --topic /odom --dask tcp://scheduler:8786
    """
    from rosld.server.cli.export import ExportJob
    from rosld.server.cli.export import export as run
    from rosld.server.cli.recording_inputs import Selection

    job = ExportJob(selection=Selection(topics, begin, end), format=format)
    run(recordings, types, job, output, workers, dask)


COMMANDS = (lift, export)
