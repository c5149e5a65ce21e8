"""Options that several commands share, and those that are declared as settings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import click

from rosld.adapters.model import Qos, read_profile
from rosld.adapters.registry import joined
from rosld.server import settings as declared
from rosld.server.cli import config_file
from rosld.server.cli.failure import ExitCode, Failure, user_errors
from rosld.server.settings import Declaration, Settings

_F = TypeVar("_F", bound=Callable[..., Any])
DEFAULT_BASE = "http://127.0.0.1:8080/"
FILE = click.Path(exists=True, dir_okay=False, path_type=Path)
FOLDER = click.Path(file_okay=False, path_type=Path)
_KINDS: Mapping[str, click.ParamType[Any]] = {
    "int": click.INT,
    "float": click.FLOAT,
    "str": click.STRING,
    "Path | None": FOLDER,
    "tuple[Path, ...]": FOLDER,
}


_QUOTE = "Quote globs, such as --history '*', or the shell expands them to file names"


class GlobCommand(click.Command):
    """A command with glob options, which a shell expands to file names unless they are quoted."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        try:
            return super().parse_args(ctx, args)
        except click.BadParameter as error:
            name = None if error.param is None else error.param.name
            if name is None or not (place := config_file.place_of(ctx, name)):
                raise
            raise Failure(f"{place}{name}: {error.message}", ExitCode.USAGE) from error
        except click.UsageError as error:
            if "unexpected extra argument" not in error.message:
                raise
            raise click.UsageError(f"{error.message}. {_QUOTE}", ctx) from error


class _SourceType(click.Path):
    """A source, which may be a path; in the environment, spaces separate several."""

    def split_envvar_value(self, rv: str) -> list[str]:
        return rv.split()


def source_argument(*, required: bool = True) -> Callable[[_F], _F]:
    """Return the argument of one source, or of several recordings and folders, which are a collection."""
    return click.argument(
        "source", nargs=-1, required=required, type=_SourceType(), callback=_joined, envvar="ROSLD_SOURCE"
    )


def _joined(context: click.Context, parameter: click.Parameter, sources: tuple[str, ...]) -> str | None:
    """Return one source, or several as the source of a collection. Raises UsageError unless several are recordings."""
    if not sources:
        return None
    try:
        return joined(sources)
    except ValueError as error:
        raise click.UsageError(f"{error}. {_QUOTE}", context) from error


def _pairs(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """Return the pairs in NAME=IP options."""
    pairs = tuple((name, address) for name, _, address in (value.partition("=") for value in values))
    for value, pair in zip(values, pairs, strict=True):
        if not all(pair):
            raise click.BadParameter(f"{value!r} is not NAME=IP")
    return pairs


def _profiles(
    context: click.Context, parameter: click.Parameter, values: tuple[str, ...]
) -> tuple[tuple[str, Qos], ...]:
    """Return the globs and profiles in GLOB=PROFILE options; a glob may contain an equals sign, a profile does not."""
    profiles: list[tuple[str, Qos]] = []
    for value in values:
        glob, _, profile = value.rpartition("=")
        if not glob.startswith(("/", "*")):
            raise click.BadParameter(f"{value!r} is not GLOB=PROFILE with the GLOB of a topic, such as '/camera/*'")
        try:
            profiles.append((glob, read_profile(profile)))
        except ValueError as error:
            raise click.BadParameter(f"in {value!r} {error}") from error
    return tuple(profiles)


_CALLBACKS: Mapping[str, Callable[[click.Context, click.Parameter, tuple[str, ...]], object]] = {
    "host_map": _pairs,
    "qos": _profiles,
}


def _option(one: Declaration) -> Callable[[_F], _F]:
    """Return the click option of a declared setting."""
    assert one.option is not None
    if one.type == "bool":
        variable = config_file.variable(one.name)
        return click.option(one.option, one.name, is_flag=True, envvar=variable, help=one.help)
    shown = one.default not in (None, ()) and one.name != "base_url"
    return click.option(
        one.option,
        one.name,
        type=FILE if one.metavar == "FILE" else _KINDS.get(one.type, click.STRING),
        multiple=one.type.startswith("tuple"),
        callback=_CALLBACKS.get(one.name),
        default=None if one.name == "base_url" else one.default,
        show_default=shown,
        metavar=one.metavar,
        envvar=config_file.variable(one.name),
        help=one.help,
    )


_ELSEWHERE = (
    click.option(
        "--config",
        type=FILE,
        is_eager=True,
        expose_value=False,
        callback=config_file.load,
        envvar="ROSLD_CONFIG",
        metavar="FILE",
        help="A file of settings by name (TOML), of source, and of [robots]. Options and variables precede it.",
    ),
    click.option("--setting", "others", nargs=2, multiple=True, metavar="NAME VALUE", help="Any other setting."),
)


def setting_options(*names: str) -> Callable[[_F], _F]:
    """Return the options of these settings; by default all, with `--setting` and `--config`."""

    def decorate(command: _F) -> _F:
        for add in () if names else _ELSEWHERE:
            command = add(command)
        for one in reversed(declared.declarations()):
            if one.option is not None and (not names or one.name in names):
                command = _option(one)(command)
        return command

    return decorate


def output_option(help: str) -> Callable[[_F], _F]:
    """Return the option that names the file to write."""
    path = click.Path(dir_okay=False, path_type=Path)
    return click.option("-o", "--output", required=True, type=path, metavar="FILE", help=help)


def settings_of(others: tuple[tuple[str, str], ...], base_url: str | None, **options: Any) -> Settings:
    """Return the settings for the parameters of `serve`, the environment and the file. Raises Failure."""
    context = click.get_current_context()
    given = {name.replace("-", "_"): text for name, text in others}
    config_file.warn_of_variables()
    with user_errors(ExitCode.USAGE):
        try:
            texts = {**config_file.others_given(context), **given}
            options |= {name: declared.parse(name, text) for name, text in texts.items()}
            if base_url is not None:
                options["base_url"] = declared.canonical_base(base_url)
            return Settings(**options)
        except ValueError as error:
            raise ValueError(config_file.located(context, str(error), given)) from error
