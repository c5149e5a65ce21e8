"""Permissions of OpenID Connect agents for past values: in queries, and in recordings that wait for a trigger."""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Callable

import httpx
import pytest

from tests.server.auth.conftest import Guarded, rule
from tests.server.auth.issuer import Issuer
from tests.server.history.test_recordings import SPEED, count, value
from tests.waiting import until

pytestmark = pytest.mark.slow

ISSUER = '[[issuer]]\nurl = "{url}"\naudience = "robot"\n'
ANNA = '[[agent]]\nname = "anna"\nissuer = "{url}"\nsubject = "anna-1"\n'
BERT = '[[agent]]\nname = "bert"\nissuer = "{url}"\nsubject = "bert-2"\n'
RULES = rule("anna", "read write", "/**") + rule("{url}#bert-2", "read write", "/sparql", "/bags/**", "/topics/**")
HIDDEN = rule("{url}#bert-2", "read", "/topics/aircraft/**", deny=True)
TOPICS = "SELECT DISTINCT ?name { ?topic ros:name ?name ; ros:past ?message }"


@pytest.fixture
def guarded(guard: Callable[..., Guarded], issuer: Issuer) -> Guarded:
    """An aircraft that records its speed."""
    return guard((ISSUER + ANNA + RULES + HIDDEN).format(url=issuer.url), options=("--history", SPEED))


def client(guarded: Guarded, issuer: Issuer, subject: str) -> httpx.Client:
    headers = {"Authorization": f"Bearer {issuer.token(sub=subject, exp=time.time() + 3600)}"}
    return httpx.Client(base_url=guarded.url, headers=headers, timeout=15)


def topics(http: httpx.Client) -> set[str]:
    answer = http.post("/sparql", data={"query": TOPICS}, headers={"Accept": "text/csv"})
    assert answer.status_code == 200, answer.text
    return {row[0] for row in list(csv.reader(io.StringIO(answer.text)))[1:]}


def order(http: httpx.Client, name: str) -> httpx.Response:
    trigger = {"resource": f"/topics{SPEED}", "condition": "data < -1"}
    return http.post("/bags/", json={"name": name, "topics": [SPEED], "trigger": trigger})


def test_a_subject_is_told_of_the_past_what_the_rules_on_it_allow(guarded: Guarded, issuer: Issuer) -> None:
    anna, bert, carl = (client(guarded, issuer, each) for each in ("anna-1", "bert-2", "carl-3"))
    until(lambda: SPEED in topics(anna), "a past")
    assert SPEED not in topics(bert)
    assert carl.post("/sparql", data={"query": TOPICS}).status_code == 404
    until(lambda: anna.get(f"/topics{SPEED}?at=-1").status_code == 200, "a past of a second")
    assert [each.get(f"/topics{SPEED}?at=-1").status_code for each in (bert, carl)] == [403, 404]
    guarded.file.write_text((ISSUER + ANNA + RULES).format(url=issuer.url))
    until(lambda: SPEED in topics(bert), "the rights that the file gives now")


def test_an_order_of_a_subject_is_judged_by_whatever_the_file_says_of_the_subject_now(
    guarded: Guarded, issuer: Issuer
) -> None:
    anna, bert = client(guarded, issuer, "anna-1"), client(guarded, issuer, "bert-2")
    assert order(bert, "speed").status_code == 403, "what must not be read is not waited for"

    def write(text: str) -> None:
        guarded.file.write_text(text.format(url=issuer.url))

    def is_so(name: str, status: str, words: str = "") -> None:
        def holds() -> bool:
            problem = value(anna, f"/bags/{name}/", "recordingProblem") or ""
            return value(anna, f"/bags/{name}/", "recordingStatus") == status and words in problem

        until(holds, f"{name} to be {status}: {words}")

    write(ISSUER + ANNA + RULES)
    until(lambda: order(bert, "speed").status_code == 201, "the rights that the file gives now")
    assert order(anna, "own").status_code == 201
    is_so("speed", "armed")
    write(ISSUER + ANNA + RULES + HIDDEN)
    is_so("speed", "suspended", f"may no longer read /topics{SPEED}")
    is_so("own", "armed")
    write(ISSUER + ANNA + RULES)
    is_so("speed", "armed")
    write(ISSUER + ANNA + BERT + RULES)  # another holder of the name has the permissions of the name: none
    is_so("speed", "suspended", "may no longer record")
    write(ISSUER + ANNA + BERT + RULES.replace('["anna"]', '["anna", "bert"]'))
    is_so("speed", "armed")
    assert count(anna, "/bags/speed/") == 0
    token = anna.headers["Authorization"]
    write(ISSUER.replace("{url}", "https://other.example") + RULES.replace('["anna"]', '["anybody"]'))
    anna.headers.pop("Authorization")
    is_so("speed", "suspended", "no longer known")
    is_so("own", "suspended", "no longer known")
    anna.headers["Authorization"] = token
    write(ISSUER + ANNA + RULES)
    is_so("speed", "armed")
    is_so("own", "armed")
