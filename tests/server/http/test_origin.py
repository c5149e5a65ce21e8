"""Host, Origin and CORS: names and origins from which clients may access this server."""

from __future__ import annotations

import pytest

from rosld.server.http.origin import check_host, check_origin, cors_headers, is_loopback, is_wildcard, origin_policy
from rosld.server.http.problem import Problem

LOCAL = origin_policy("http://127.0.0.1:8080/", "127.0.0.1", 8080)
PROXIED = origin_policy("https://robot.example/", "127.0.0.1", 8080, ["https://App.example"])
SEEN = origin_policy("http://10.0.0.7:8080/", "10.0.0.7", 8080)
OPEN = origin_policy("http://127.0.0.1:8080/", "127.0.0.1", 8080, ["*"])


def test_a_server_answers_to_its_base_and_on_loopback_to_loopback_names_with_its_port() -> None:
    for host in ("127.0.0.1:8080", "localhost:8080", "LOCALHOST:8080", "[::1]:8080", "localhost.:8080"):
        check_host(LOCAL, [host])
        check_host(PROXIED, [host])
    for host in ("robot.example", "robot.example:443", "ROBOT.example"):
        check_host(PROXIED, [host])
    check_host(SEEN, ["10.0.0.7:8080"])
    with pytest.raises(Problem, match="421"):
        check_host(SEEN, ["localhost:8080"])
    for hosts in ([], ["127.0.0.1:8080", "127.0.0.1:8080"]):
        with pytest.raises(Problem, match="400"):
            check_host(LOCAL, hosts)


def test_a_star_shares_reads_and_never_writes() -> None:
    assert cors_headers(OPEN, "GET", "https://any.example")["access-control-allow-origin"] == "*"
    assert (
        "PUT"
        not in cors_headers(OPEN, "OPTIONS", "https://any.example", preflight=True)["access-control-allow-methods"]
    )
    assert "access-control-allow-origin" not in cors_headers(OPEN, "PUT", "https://any.example")
    with pytest.raises(Problem, match="403"):
        check_origin(OPEN, "PUT", "https://any.example")
    with pytest.raises(Problem, match="403"):
        check_origin(OPEN, "PUT", "*")


def test_loopback_and_wildcard_addresses_are_known() -> None:
    assert all(map(is_loopback, ["127.0.0.1", "127.1.2.3", "::1", "[::1]", "localhost"]))
    assert not any(map(is_loopback, ["0.0.0.0", "::", "10.0.0.7", "robot", ""]))
    assert all(map(is_wildcard, ["0.0.0.0", "::", "[::]", ""]))
    assert not any(map(is_wildcard, ["127.0.0.1", "robot"]))
