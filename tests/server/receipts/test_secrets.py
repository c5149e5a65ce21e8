"""Detection of credentials in any notation, without false positives in typical texts of robots."""

from __future__ import annotations

import time

from rosld.server.receipts.audit import holds_credentials


def test_credentials_are_found() -> None:
    for text in (
        '{"password": "hunter2"}',
        '{"Pass": "hunter2"}',
        "user=me&passwd=hunter2",
        "p%61ssword=hunter2",
        '{"\\u0070assword": "hunter2"}',
        '<> <http://example.org/passPhrase> "open sesame" .',
        '{"ssid": "lab", "psk": "12345678"}',
        '{"wifi_key": "12345678"}',
        '{"apiKey": "1"}',
        "access_token=abc",
        "Authorization: Basic dXNlcjpwYXNz",
        "Basic dXNlcjpwYXNzd29yZA==",
        "Bearer abcdefgh",
        "Set-Cookie: a=b",
        "eyJhbGciOiJIUzI1NiJ9.eyJzdWIiOiIxIn0.c2lnbmF0dXJl",
        "-----BEGIN RSA PRIVATE KEY-----",
        "https://me:hunter2@example.org/",
        "ghp_0123456789abcdefABCDEF",
        "AKIAIOSFODNN7EXAMPLE",
        '"mF9ZzQ3k2LxV8tRb7NwYp1Sd"',
        "f81d4fae7dec11d0a76500a0c91e6bf6",
    ):
        assert holds_credentials(text)


def test_what_robots_say_is_no_secret() -> None:
    for text in (
        "",
        '{"data": "climb to 3000"}',
        '{"linear": {"x": 0.25, "y": 0.0, "z": 0.0}, "angular": {"z": -1.5}}',
        '<#message> a <https://w3id.org/rosld/types/std_msgs/msg/String> ; <#data> "compass, passenger, keyboard" .',
        "INSERT DATA { GRAPH </parameters/cabin/height> { </parameters/cabin/height> ros:value 10 } }",
        '{"header": {"frame_id": "base_link", "stamp": {"sec": 1700000000, "nanosec": 123456789}}}',
        "http://127.0.0.1:8080/resources/aircraft/engine/speed",
        "see http://example.org:8080/a@b",
        "<> <http://purl.org/dc/terms/author> <http://example.org/me> .",
    ):
        assert not holds_credentials(text)


def test_no_text_takes_long() -> None:
    for piece in ("eyj", "basic ", "://", "a1", "\\u0061", "pass ", "://a:", "sk-", "%41", "key ", "private "):
        text = piece * 100_000
        begun = time.thread_time()
        holds_credentials(text)
        assert time.thread_time() - begun < 3, "it takes minutes where it looks twice at each"
