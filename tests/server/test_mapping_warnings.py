"""A mapping that names missing or unavailable resources is in force, with a warning in the response."""

from __future__ import annotations

from pathlib import Path

import httpx
import pytest

from rosld.adapters.model import Action, Service, TypeRef
from tests.server.robots.made_up import MadeUp, Serving
from tests.waiting import until

pytestmark = pytest.mark.slow

PREFIXES = """
@prefix map: <https://w3id.org/rosld/mapping#> . @prefix ex: <http://example.org/> .
@prefix sh: <http://www.w3.org/ns/shacl#> . @prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> .
"""
TURTLE = {"Content-Type": "text/turtle"}

WORDS = "https://w3id.org/rosld#mappingWarning"


def mapping(what: str) -> str:
    return f'{PREFIXES}<#arm> a map:ComplexResource ; map:path "/arm/" ; {what} .'


NO_STATE = '[ a sh:NodeShape ; map:about "{}" ; sh:property [ sh:path rdf:value ; sh:hasValue 1 ] ]'
VAIN = {
    'map:property [ map:predicate ex:p ; map:member "pos" ]': (
        "map:member /arm/pos: no such topic, parameter or getter (there is /arm/pose)"
    ),
    'map:property [ map:predicate ex:p ; map:member "/far/away" ]': (
        "map:member /far/away: no such topic, parameter or getter"
    ),
    'map:property [ map:predicate ex:p ; map:member "pose" ; map:field "position.w" ]': (
        "map:field position.w: /arm/pose has no such scalar"
    ),
    'map:property [ map:predicate ex:p ; map:member "pose" ; map:field "position" ]': (
        "map:field position: /arm/pose has no such scalar"
    ),
    f'map:property [ map:predicate ex:p ; map:member "grip" ; map:writableWhen {NO_STATE.format("/arm/grip")} ]': (
        "map:writableWhen of /arm/grip: no topic, parameter or setter can write it"
    ),
    'map:action [ map:relation ex:a ; map:service "ame" ]': (
        "map:service /arm/ame: there is no such service or action (there is /arm/aim)"
    ),
    'map:action [ map:relation ex:a ; map:service "odd" ]': (
        "map:service /arm/odd: it cannot be offered, because its type is not known"
    ),
    'map:action [ map:relation ex:a ; map:service "pick" ]': (
        "map:service /arm/pick: it cannot be offered, because its type is not known"
    ),
    'map:link [ map:relation ex:l ; map:target "/hand/" ]': "map:target /hand/: there is no such resource",
    f"map:existsWhen {NO_STATE.format('/arm/gone')}": (
        "map:about /arm/gone: there is no such resource, so the condition never holds"
    ),
    'map:stop [ map:call "aimm" ]': "map:call /arm/aimm: there is no such service (there is /arm/aim)",
    'map:stop [ map:publish "/arm/posse" ]': "map:publish /arm/posse: there is no such topic (there is /arm/pose)",
}
GOOD = (
    'map:property [ map:predicate ex:p ; map:member "pose" ; map:field "position.x" ]',
    'map:property [ map:predicate ex:p ; map:member "grip" ]',
    'map:action [ map:relation ex:a ; map:service "aim" ]',
    'map:link [ map:relation ex:l ; map:target "/arm/" ]',
    'map:stop [ map:call "aim" ] , [ map:publish "pose" ]',
    f"map:existsWhen {NO_STATE.format('/arm/grip')}",
)


@pytest.fixture
def http(robot: MadeUp, serving: Serving) -> httpx.Client:
    """A robot with an arm."""
    robot.topic("/arm/pose", "geometry_msgs/msg/Pose", {})
    robot.variable("/arm/grip", "Byte", set=None, value=1)
    robot.answer("/arm/aim", "made_up/srv/Aim")
    robot.strange(Service("/arm/odd", None, ("/robot",), "its node does not report its type"))
    robot.strange(Action("/arm/pick", TypeRef("made_up/action/Pick"), ("/robot",)))
    return serving()


def put(http: httpx.Client, what: str, **headers: str) -> httpx.Response:
    return http.put("/mappings/mine", content=mapping(what), headers={**TURTLE, **headers})


def test_what_is_named_in_vain_is_told_where_the_mapping_is_put(http: httpx.Client) -> None:
    for what, words in VAIN.items():
        answer = put(http, what)
        assert answer.is_success
        assert answer.json()["warnings"] == [f"/arm/: {words}."]
        assert words in answer.json()["detail"]
        assert http.get("/mappings/mine").status_code == 200, "it is in force all the same"
    for what in GOOD:
        assert put(http, what).status_code == 204, what
        assert WORDS not in http.get("/resources/arm/", headers={"Accept": "application/n-triples"}).text


def test_the_resource_says_so_until_the_robot_has_it(http: httpx.Client, robot: MadeUp) -> None:
    what = 'map:property [ map:predicate ex:p ; map:member "force" ]'
    put(http, what)

    def told() -> bool:
        return WORDS in http.get("/resources/arm/", headers={"Accept": "application/n-triples"}).text

    assert told()
    assert "no such topic, parameter or getter" in http.get("/resources/arm/", headers={"Accept": "text/html"}).text
    robot.parameter("/arm/force", 5)
    until(lambda: not told(), "the force")
    assert put(http, what).status_code == 204


def test_patches_and_posts_are_told_as_well_but_not_in_place_of_what_a_client_prefers(http: httpx.Client) -> None:
    what = next(iter(VAIN))
    minimal = put(http, what, Prefer="return=minimal")
    assert (minimal.status_code, minimal.text) == (201, "")
    whole = put(http, what, Prefer="return=representation", Accept="text/turtle")
    assert whole.status_code == 200
    assert "map:ComplexResource" in whole.text
    assert "vain" not in whole.text
    assert http.delete("/mappings/mine").status_code == 204
    made = http.post("/mappings/", content=mapping(what), headers={**TURTLE, "Slug": "posted"})
    assert made.status_code == 201
    assert made.json()["warnings"]
    assert made.headers["location"] == f"{http.base_url}mappings/posted"
    update = "INSERT DATA { <#arm> <http://www.w3.org/2000/01/rdf-schema#label> 'Arm' }"
    patched = http.patch("/mappings/posted", content=update, headers={"Content-Type": "application/sparql-update"})
    assert (patched.status_code, bool(patched.json()["warnings"])) == (200, True)


def test_a_mapping_to_begin_with_is_told_of_in_the_log(
    robot: MadeUp, serving: Serving, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    robot.topic("/arm/pose", "geometry_msgs/msg/Pose", {})
    for name, member in (("right", "pose"), ("wrong", "posse")):
        (tmp_path / f"{name}.ttl").write_text(
            f'{PREFIXES} <#it> a map:ComplexResource ; map:path "/{name}/" ; '
            f'map:property [ map:predicate ex:p ; map:member "/arm/{member}" ] .'
        )
    serving(mapping=(tmp_path / "right.ttl", tmp_path / "wrong.ttl"))
    until(lambda: "names things that do not exist" in caplog.text, "the warning")
    (warning,) = [
        record.getMessage() for record in caplog.records if "names things that do not exist" in record.getMessage()
    ]
    assert "/mappings/wrong" in warning
    assert "map:member /arm/posse: no such topic, parameter or getter (there is /arm/pose)" in warning
