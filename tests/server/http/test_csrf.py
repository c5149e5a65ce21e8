"""Form tokens."""

from __future__ import annotations

import pytest

from rosld.server.http.csrf import FormKey
from rosld.server.http.problem import Problem


def test_a_token_is_valid_for_its_action_in_its_run_only() -> None:
    key, other = FormKey(), FormKey()
    token = key.token("http://127.0.0.1:8080/services/aircraft/start")
    assert key.is_valid(token, "http://127.0.0.1:8080/services/aircraft/start")
    assert not key.is_valid(token, "http://127.0.0.1:8080/services/aircraft/stop")
    assert not other.is_valid(token, "http://127.0.0.1:8080/services/aircraft/start")


def test_a_form_without_its_token_is_403() -> None:
    for token in (None, "", "x", "ü\ud800", "A" * 10_000):
        with pytest.raises(Problem, match="403"):
            FormKey().require(token, "/a")


def test_the_key_is_not_shown() -> None:
    assert "key" not in repr(FormKey())
