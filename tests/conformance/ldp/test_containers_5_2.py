"""LDP 5.2 and 5.3: containers, and Basic containers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pyoxigraph import Literal, NamedNode

from rosld.ontology.vocab import ldp, rdf, xsd
from tests.conformance.ldp.conftest import links, models

if TYPE_CHECKING:
    from tests.conformance.ldp.conftest import Place, Served

P = NamedNode("http://ex.org/p")
CONTAINERS = ("BasicContainer", "DirectContainer", "IndirectContainer")
TURTLE = "text/turtle"


def test_5_2_1_3_members_are_in_no_rdf_list_or_bag(containers: list[Place]) -> None:
    for container in containers:
        contained = container.contained()
        for each in container.graph():
            if each.predicate == rdf.first or each.predicate.value.startswith(f"{rdf.iri}_"):
                assert not (isinstance(each.object, NamedNode) and each.object.value in contained), container.url


def test_5_2_1_4_every_answer_links_to_the_type_of_container(place: Place, kinds: dict[str, str]) -> None:
    for model in CONTAINERS:
        said = "<> <http://ex.org/topic> <#t> ."
        answers = [place.send(method, kinds[model]) for method in ("GET", "HEAD", "OPTIONS")]
        answers += [place.send("POST", kinds[model], said, TURTLE), place.send("POST", kinds[model], "no", TURTLE)]
        answers += [place.send("PUT", kinds[model], "no", TURTLE), place.send("DELETE", kinds[model])]
        for answer in answers[:3]:
            assert models(answer) & set(CONTAINERS) == {model}
        assert answers[3].status_code == 201
        assert model in models(answers[3])
        assert [answer.status_code for answer in answers[4:]] == [400, 400, 409]
        for answer in answers[4:]:
            assert model in models(answer)


def test_5_2_3_1_post_makes_a_member(place: Place, kinds: dict[str, str]) -> None:
    """Of the graph in the body, which is about the new resource; or of bytes of any media type."""
    for model in CONTAINERS:
        made = place.post('<> <http://ex.org/topic> <#t> ; <http://ex.org/p> "x" .', to=kinds[model])
        assert made.startswith(kinds[model])
        assert place.objects(made, P) == {Literal("x")}
        assert place.contained(kinds[model]) == {made}
    for body, media_type in (('{"@id": "", "http://ex.org/p": "x"}', "application/ld+json"), (b"\x89", "image/png")):
        made = place.send("POST", "", body, media_type).headers["location"]
        assert made in place.contained()
        if media_type == "image/png":
            assert place.get(made).content == body
        else:
            assert place.objects(made, P) == {Literal("x")}


def test_5_2_3_1_post_makes_a_parameter(served: Served) -> None:
    parameters = served.at("parameters/")
    body = '<> <https://w3id.org/rosld#value> "made by a POST" .'
    answer = parameters.send("POST", "", body, TURTLE, Slug="made_by_a_post")
    assert answer.status_code == 201, answer.text
    made = answer.headers["location"]
    assert made in parameters.contained()
    assert parameters.send("DELETE", made).status_code == 204
    assert made not in parameters.contained()


def test_5_2_3_4_the_interaction_model_asked_for_is_honoured(place: Place) -> None:
    said = f"<> <{ldp.iri}insertedContentRelation> <http://ex.org/topic> ."
    for model in CONTAINERS:
        made = place.post(said if model == "IndirectContainer" else "", model=model)
        assert made.endswith("/")
        assert model in models(place.get(made))
        assert place.post("<> <http://ex.org/topic> <#t> .", to=made).startswith(made)
    for model in ("Resource", "RDFSource"):
        made = place.post(model=model)
        assert models(place.get(made)) == {"Resource", "RDFSource"}
        answer = place.send("POST", made, "", TURTLE)  # merged into the existing resource: nothing is created
        assert (answer.status_code, answer.headers.get("location")) == (204, None)


def test_5_2_3_4_what_cannot_be_honoured_is_refused(place: Place) -> None:
    before = place.contained()
    assert place.send("POST", "", "", TURTLE, model="NoSuchThing").status_code == 400
    assert place.send("POST", "", b"\x89PNG", "image/png", model="RDFSource").status_code == 409
    assert place.send("POST", "", b"\x89PNG", "image/png", model="BasicContainer").status_code == 409
    assert place.send("PUT", "a", "", TURTLE, model="BasicContainer").status_code == 409
    both = f'<{ldp.iri}BasicContainer>; rel="type", <{ldp.iri}DirectContainer>; rel="type"'
    assert place.send("POST", "", "", TURTLE, Link=both).status_code == 400
    assert place.contained() == before


def test_5_2_3_4_the_interaction_model_never_changes(place: Place, kinds: dict[str, str]) -> None:
    assert place.send("PUT", "rdf", b"\x89PNG", "image/png").status_code == 415
    for name, body, media_type, model in (
        ("rdf", b"<> <http://ex.org/p> 1 .", TURTLE, "NonRDFSource"),
        ("basic/", b"", TURTLE, "DirectContainer"),
        ("direct/", b"", TURTLE, "BasicContainer"),
        ("file.txt", b"<> <http://ex.org/p> 1 .", TURTLE, "RDFSource"),
    ):
        before = place.get(name)
        assert place.send("PUT", name, body, media_type, model=model).status_code == 409, (name, model)
        assert place.get(name).content == before.content
    assert set(kinds.values()) == place.contained()


def test_5_2_3_6_the_content_type_says_what_a_body_is(place: Place) -> None:
    """The same bytes are Turtle or text according to Content-Type; nothing is guessed."""
    body = "<> <http://ex.org/p> 1 ."
    made = [place.send("POST", "", body, kind).headers["location"] for kind in ("text/plain", TURTLE)]
    assert place.get(made[0]).text == body
    assert place.objects(made[1], P)
    assert place.send("POST", "", body).status_code == 415


def test_5_2_3_8_without_a_hint_the_server_names_the_resource(place: Place) -> None:
    one, other = place.post(), place.post()
    assert one != other
    for made in (one, other):
        assert made.startswith(place.url)
        assert "/" not in made.removeprefix(place.url)


def test_5_2_3_9_anything_can_be_made_without_knowing_constraints(place: Place) -> None:
    for body in ("", "<#it> <http://ex.org/p> [ <http://ex.org/q> ( 1 2 ) ] .", "<urn:x> a <urn:y> ."):
        assert place.send("POST", "", body, TURTLE).status_code == 201


def test_5_2_3_10_a_slug_names_the_resource_and_is_made_safe(place: Place) -> None:
    assert place.post(Slug="kitchen") == place.at("kitchen")
    assert place.post(Slug="kitchen") == place.at("kitchen-2")
    for slug in ("../../etc/passwd", "a/b?c#d", "%2e%2e%2f", "", "a.meta", "<script>"):
        made = place.post(Slug=slug)
        name = made.removeprefix(place.url)
        assert made.startswith(place.url)
        assert name
        assert not set(name) & set("/?#<>")
        assert not name.startswith(".")
        assert not name.endswith(".meta")
        assert place.get(made).status_code == 200


def test_5_2_3_13_everything_can_be_posted_under_data(place: Place) -> None:
    accepted = place.send("OPTIONS").headers["accept-post"]
    assert TURTLE in accepted
    assert "application/ld+json" in accepted
    assert "*/*" in accepted


def test_5_2_4_1_put_cannot_change_containment(place: Place) -> None:
    kept, other = place.post(), place.post()
    for said in (f"<> <{ldp.iri}contains> <{kept}> .", f"<> <{ldp.iri}contains> <{kept}> , <{other}> , <more> ."):
        answer = place.send("PUT", "", said, TURTLE)
        assert answer.status_code == 409
        assert place.contained() == {kept, other}


def test_5_2_4_1_put_without_containment_leaves_it_as_it_is(place: Place) -> None:
    kept = place.post()
    place.put("", '<> <http://ex.org/p> "mine" .')
    assert place.contained() == {kept}
    assert place.objects("", P) == {Literal("mine")}


def test_5_2_4_2_put_makes_again_what_was_deleted(place: Place, kinds: dict[str, str]) -> None:
    for kind, url in kinds.items():
        before = place.get(url).headers["etag"]
        assert place.send("DELETE", url).status_code == 204
        assert url not in place.contained()
        assert place.send("PUT", url, "<> <http://ex.org/p> 2 .", TURTLE, If_Match=before).status_code == 412
        assert place.get(url).status_code == 410
        answer = place.send("PUT", url, "<> <http://ex.org/p> 2 .", TURTLE, If_None_Match="*")
        assert (answer.status_code, answer.headers["location"]) == (201, url), kind
        assert place.objects(url, P) == {Literal("2", datatype=xsd.integer)}
        assert place.get(url).headers["etag"] != before
        assert url in place.contained()


def test_5_2_5_1_a_container_with_members_is_not_deleted(place: Place) -> None:
    place.put("c/a", "<> <http://ex.org/p> 1 .")
    assert place.send("DELETE", "c/").status_code == 409
    assert place.contained("c/") == {place.at("c/a")}
    for name in ("c/a", "c/"):
        assert place.send("DELETE", name).status_code == 204
    place.put("c/a", "<> <http://ex.org/p> 2 .")
    assert place.contained("c/") == {place.at("c/a")}


def test_5_2_5_2_a_description_comes_and_goes_with_its_file(place: Place) -> None:
    place.put("rdf", "<> <http://ex.org/p> 1 .")
    for name in ("a.meta", "rdf.meta"):
        assert place.send("PUT", name, "<> <http://ex.org/p> 1 .", TURTLE).status_code == 404
    assert place.send("PUT", "a", b"\x89PNG", "image/png").status_code == 201
    assert place.get("a.meta").status_code == 200
    assert place.send("DELETE", "a").status_code == 204
    assert [place.get(name).status_code for name in ("a", "a.meta")] == [410, 410]


def test_5_2_7_1_patch_changes_what_a_container_says(place: Place, kinds: dict[str, str]) -> None:
    for model in CONTAINERS:
        made = place.post("<> <http://ex.org/topic> <#t> .", to=kinds[model])
        update = 'INSERT DATA { <> <http://ex.org/p> "patched" }'
        assert place.send("PATCH", kinds[model], update, "application/sparql-update").is_success
        assert place.objects(kinds[model], P) == {Literal("patched")}
        assert place.contained(kinds[model]) == {made}


def test_5_2_7_1_patch_cannot_change_containment(place: Place) -> None:
    kept = place.post()
    for update in (
        f"DELETE DATA {{ <> <{ldp.iri}contains> <{kept}> }}",
        f"INSERT DATA {{ <> <{ldp.iri}contains> <more> }}",
    ):
        assert place.send("PATCH", "", update, "application/sparql-update").status_code == 409
        assert place.contained() == {kept}


def test_5_2_7_1_patch_changes_the_values_in_a_container_of_parameters(served: Served) -> None:
    parameters = served.at("parameters/")
    answer = parameters.send("PATCH", "", '{"patched": 1}', "application/merge-patch+json")
    assert answer.is_success
    assert parameters.get("patched", Accept="application/json").json() == 1
    assert parameters.send("DELETE", "patched").status_code == 204


def test_5_2_8_1_a_file_links_to_its_description_from_its_creation_on(place: Place) -> None:
    made = place.send("POST", "", b"\x89PNG", "image/png", Slug="a")
    assert (made.status_code, made.content, made.headers["location"]) == (201, b"", place.at("a"))
    answers = [made, *(place.send(method, "a") for method in ("GET", "HEAD", "OPTIONS"))]
    answers += [
        place.send("PUT", "a", b"\x89PNG2", "image/png"),
        place.send("PUT", "a", b"x", "image/png", If_Match='"x"'),
    ]
    for answer in answers:
        found = [each for each in links(answer) if each.rel == "describedby"]
        assert {each.target for each in found} == {place.at("a.meta")}
        assert answer.status_code != 201 or place.at("a") in {each.anchor for each in found}


def test_5_3_1_1_members_are_linked_by_containment_only(place: Place, served: Served) -> None:
    made = place.post()
    links = {each.predicate for each in place.graph() if getattr(each.object, "value", None) == made}
    assert links == {ldp.contains}
    assert f"{served.url}data/" in served.at("").contained()
