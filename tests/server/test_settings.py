"""Settings: declared once, documented, and validated on creation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from rosld.server import settings as declared
from rosld.server.cli.main import main
from rosld.server.settings import Settings

ROOT = Path(__file__).parent.parent.parent


def test_the_page_of_settings_is_up_to_date() -> None:
    written = (ROOT / "docs" / "reference" / "settings.md").read_text("utf-8")
    assert written == declared.describe(), "run: python -m rosld.server.settings > docs/reference/settings.md"


BAD_VALUES: tuple[tuple[dict[str, Any], str], ...] = (
    ({"port": -1}, "--port"),
    ({"port": 65536}, "--port"),
    ({"max_publish_rate": float("nan")}, "--max-publish-rate"),
    ({"rate": float("inf")}, "--rate"),
    ({"body_limit": 0}, "body_limit"),
    ({"base_url": "ftp://robot/"}, "--base-url"),
    ({"base_url": "http://robot/?x"}, "--base-url"),
    ({"base_url": "http://u:p@robot/"}, "--base-url"),
    ({"base_url": 'http://robot/">'}, "--base-url"),
    ({"base_url": "http://robot"}, "--base-url"),
    ({"cors_origins": ("app.example",)}, "--cors-origin"),
    ({"types_namespace": "nonsense"}, "types_namespace"),
    ({"history": ("/odom", "scan")}, "--history scan: must begin with a slash or a star"),
    ({"subscribe": ("",)}, "--subscribe"),
    ({"allow_publish": ("cmd_vel",)}, "--allow-publish cmd_vel"),
    ({"stop_zero": ("!cmd_vel",)}, "--stop-zero cmd_vel"),
    ({"stop_cancels": "all"}, "--stop-cancels all: must be own or others"),
)


def test_a_bad_value_is_refused_by_the_name_of_its_option() -> None:
    for values, words in BAD_VALUES:
        with pytest.raises(ValueError, match=words):
            Settings(**values)
    for host in ("0.0.0.0", "::", ""):
        with pytest.raises(ValueError, match="--base-url"):
            declared.bound(Settings(host=host), 8080, base_given=False)


def test_a_setting_without_an_option_is_parsed_or_refused_by_name() -> None:
    assert declared.parse("body_limit", "2048") == 2048
    assert declared.parse("call-deadline", "2.5") == 2.5
    assert declared.parse("types_namespace", "https://a.example/") == "https://a.example/"
    for name, text in (
        ("nonsense", "1"),
        ("port", "1"),
        ("body_limit", "much"),
        ("body_limit", "1"),
        ("idle_time", "nan"),
    ):
        with pytest.raises(ValueError, match=name):
            declared.parse(name, text)


def test_the_base_url_follows_the_address_and_the_real_port_unless_it_is_given() -> None:
    for host, port, url in (
        ("127.0.0.1", 8080, "http://127.0.0.1:8080/"),
        ("localhost", 80, "http://localhost/"),
        ("::1", 8080, "http://[::1]:8080/"),
    ):
        found = declared.bound(Settings(host=host, port=0), port, base_given=False)
        assert (found.base_url, found.port, found.read_only) == (url, port, False)
    given = Settings(base_url="https://robot.example/", port=0)
    assert declared.bound(given, 40000, base_given=True).base_url == "https://robot.example/"


def test_a_server_beyond_loopback_is_read_only() -> None:
    assert declared.bound(Settings(host="10.0.0.7"), 8080, base_given=False).read_only
    given = Settings(host="0.0.0.0", base_url="http://robot.example/")
    assert declared.bound(given, 8080, base_given=True).read_only


def test_the_adapter_gets_its_options() -> None:
    found = Settings(types=(Path("/a"),), ros_ip="10.0.0.7", host_map=(("robot", "10.0.0.1"),), rate=2.0, once=True)
    options = found.adapter_options
    assert (options.types, options.ros_ip, options.host_map) == ((Path("/a"),), "10.0.0.7", {"robot": "10.0.0.1"})
    assert (options.rate, options.once) == (2.0, True)


def test_a_bad_profile_is_refused_before_anything_is_opened() -> None:
    for value, words in (
        ("/scan", "is not GLOB=PROFILE"),
        ("scan=reliable", "is not GLOB=PROFILE"),
        ("/scan=fast", "'fast' is not a policy"),
    ):
        result = CliRunner().invoke(main, ["serve", "aircraft", "--qos", value], terminal_width=500)
        assert result.exit_code == 2
        assert "--qos" in result.output
        assert words in result.output
