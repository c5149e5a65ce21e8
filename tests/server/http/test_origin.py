"""Host, Origin and sharing: who may talk to this server by which name."""

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


def test_another_host_is_421_with_the_base() -> None:
    foreign = ("evil.example", "evil.example:8080", "127.0.0.1", "127.0.0.1:8081", "", "localhost:8080@evil")
    for host in (*foreign, "127.0.0.1:8080.evil.example"):
        with pytest.raises(Problem) as raised:
            check_host(LOCAL, [host])
        assert raised.value.status == 421
        assert "http://127.0.0.1:8080/" in raised.value.detail


def test_an_unsafe_method_from_a_foreign_page_is_403_and_from_own_pages_and_programs_allowed() -> None:
    for origin in ("https://evil.example", "null", "http://localhost:3000", "http://127.0.0.1", ""):
        for method in ("PUT", "POST", "PATCH", "DELETE", "PURGE"):
            for site in ("cross-site", None):
                with pytest.raises(Problem, match="403"):
                    check_origin(LOCAL, method, origin, site)
        for method in ("GET", "HEAD", "OPTIONS"):
            check_origin(LOCAL, method, origin, "cross-site")
    for site in ("cross-site", "same-site", "nonsense"):
        with pytest.raises(Problem, match="403"):
            check_origin(LOCAL, "POST", None, site)
    for own in ("http://127.0.0.1:8080", "http://localhost:8080", "http://[::1]:8080", None):
        check_origin(LOCAL, "PUT", own, "same-origin")
        check_origin(LOCAL, "PUT", own)
    check_origin(PROXIED, "PUT", "https://robot.example", "same-origin")
    with pytest.raises(Problem, match="403"):
        check_origin(PROXIED, "PUT", "http://robot.example")


def test_a_listed_origin_may_write_and_read_the_headers() -> None:
    check_origin(PROXIED, "PUT", "https://app.example", "cross-site")
    shared = cors_headers(PROXIED, "PUT", "https://app.example")
    assert shared["access-control-allow-origin"] == "https://app.example"
    assert "ETag" in shared["access-control-expose-headers"]
    assert shared["vary"] == "Origin"
    preflight = cors_headers(PROXIED, "OPTIONS", "https://app.example", preflight=True)
    assert "PATCH" in preflight["access-control-allow-methods"]
    assert "If-Match" in preflight["access-control-allow-headers"]


def test_nothing_is_shared_with_an_origin_that_is_not_listed() -> None:
    assert cors_headers(LOCAL, "GET", "https://app.example") == {}
    assert cors_headers(PROXIED, "GET", "https://evil.example") == {"vary": "Origin"}
    assert cors_headers(PROXIED, "GET", None) == {"vary": "Origin"}


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
