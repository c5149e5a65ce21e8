"""Members that cannot be read: the rest of a resource is complete, and dependent operations are not on offer."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import pytest

from rosld.adapters.model import Refused, Unreachable
from tests.server.robots import asking
from tests.server.robots.made_up import MadeUp, Serving, served

pytestmark = pytest.mark.slow

value, objects, detail, mapped = asking.value, asking.objects, asking.detail, asking.mapped
ROS, LDP, JSON, MERGE = asking.ROS, asking.LDP, asking.JSON, asking.MERGE


DOOR = """
<#door> a map:ComplexResource ; map:path "/door/" ;
  map:property [ map:predicate ex:lock ; map:member "lock" ; map:writableWhen <#unlocked> ] ;
  map:action [ map:relation ex:open ; map:service "/door/open" ; map:availableWhen <#unlocked> ] ;
  map:link [ map:relation ex:room ; map:target "/room/" ; map:availableWhen <#unlocked> ] .
<#room> a map:ComplexResource ; map:path "/room/" ; map:existsWhen <#unlocked> ;
  map:property [ map:predicate ex:light ; map:member "light" ] .
<#unlocked> a sh:NodeShape ; map:about "/door/" ; sh:property [ sh:path ex:lock ; sh:hasValue "open" ] .
"""


def refuses(words: str | None) -> Any:
    """Refuse, as a service."""

    def act(_: object) -> dict[str, Any]:
        raise Refused("the service refused without a word", words=words)

    return act


def unreadable(http: httpx.Client, path: str, member: str) -> str:
    """Return why a member of a resource cannot be read, from its RDF."""
    (why,) = objects(http.get(path), f"{ROS}unreadable", f"{http.base_url}resources{member}")
    return why


@pytest.fixture
def arm(robot: MadeUp) -> MadeUp:
    """An arm with one member that a test makes fail, and one that works."""
    robot.variable("/arm/grip", "Byte", value=1)
    robot.variable("/arm/label", "Label", set=None, success=True, label="red")
    return robot


def failing(http: httpx.Client, *words: str) -> None:
    """Check that the grip cannot be read, that everything states so, and that the label is unaffected."""
    assert value(http, "/resources/arm/") == {"grip": None, "label": "red"}
    assert value(http, "/resources/arm/grip") is None
    for path in ("/resources/arm/", "/resources/arm/grip"):
        why = unreadable(http, path, "/arm/grip")
        assert all(one in why for one in words), why
    page = http.get("/resources/arm/", headers={"Accept": "text/html"})
    assert page.status_code == 200
    assert "red" in page.text


def test_a_getter_that_hangs_is_waited_for_until_the_deadline_and_its_call_given_up(
    arm: MadeUp, serving: Serving
) -> None:
    arm.hold("/arm/get_grip")
    http = serving(read_deadline=0.2, freshness=60)
    failing(http, "/arm/get_grip did not respond within 0.2 s")
    assert arm.calls == {"/arm/get_grip": 1, "/arm/get_label": 1}
    arm.release("/arm/get_grip")
    assert value(http, "/resources/arm/") == {"grip": 1, "label": "red"}
    arm.hold("/arm/get_grip")
    http = serving(read_deadline=2, call_deadline=0.2, freshness=60)
    failing(http, "/arm/get_grip did not respond within 0.2 s")
    arm.release("/arm/get_grip")
    assert value(http, "/resources/arm/grip") is None  # its failure is as fresh as a value would be
    assert http.put("/resources/arm/grip", json=5).status_code == 204
    assert value(http, "/resources/arm/grip") == 5


def test_a_getter_that_fails_is_said_to_with_the_robots_words_apart(arm: MadeUp, serving: Serving) -> None:
    def broken(_: object) -> dict[str, Any]:
        raise RuntimeError("an inner secret")

    http = serving(freshness=0)
    without_a_word = "/arm/get_grip refused: the service refused without a word"
    for act, words in (
        (refuses("no <fingers> found"), "/arm/get_grip refused"),
        (refuses(""), without_a_word),
        (refuses(None), without_a_word),
        (broken, "/arm/get_grip cannot be read"),
    ):
        arm.offer("/arm/get_grip", "made_up/srv/GetByte", act)
        failing(http, words)
        said = objects(http.get("/resources/arm/"), f"{ROS}words", f"{http.base_url}resources/arm/grip")
        assert said == ({"no <fingers> found"} if words == "/arm/get_grip refused" else set())
    assert "secret" not in http.get("/resources/arm/").text
    arm.answer("/arm/get_grip", "made_up/srv/GetByte", value=1)
    arm.answer("/arm/get_label", "made_up/srv/GetLabel", success=False, message="it is dark", label="ignored")
    assert value(http, "/resources/arm/") == {"grip": 1, "label": None}
    assert unreadable(http, "/resources/arm/label", "/arm/label") == "/arm/get_label refused"
    assert objects(http.get("/resources/arm/label"), f"{ROS}words") == {"it is dark"}


def test_a_node_that_has_died_is_told_until_it_is_forgotten(arm: MadeUp, serving: Serving) -> None:
    http = serving(freshness=0)
    assert value(http, "/resources/arm/grip") == 1
    arm.break_off("/arm/get_grip")
    failing(http, "/arm/get_grip cannot be read", "does not answer")
    arm.offer("/arm/get_grip", "made_up/srv/GetByte", lambda _: {"value": 7})
    assert value(http, "/resources/arm/") == {"grip": 7, "label": "red"}
    arm.withdraw("/arm/get_grip")
    arm.withdraw("/arm/set_grip")
    assert value(http, "/resources/arm/") == {"label": "red"}
    assert "no resource /arm/grip" in detail(http.get("/resources/arm/grip"), 404)


def test_what_can_only_be_written_has_no_value_and_no_failure(robot: MadeUp, serving: Serving) -> None:
    robot.variable("/arm/grip", "Byte", get=None, value=1)
    http = serving()
    assert value(http, "/resources/arm/") == {"grip": None}
    answer = http.get("/resources/arm/grip")
    assert "unreadable" not in answer.text
    assert "readProperty" not in answer.text
    assert http.put("/resources/arm/grip", json=4).status_code == 204
    assert "PUT a whole value" in detail(http.patch("/resources/arm/grip", json=5, headers=MERGE), 409)


def test_a_parameter_that_has_gone_is_told(robot: MadeUp, serving: Serving) -> None:
    robot.parameter("/arm/name", "Bob")
    robot.parameter("/arm/size", 3)
    http = serving(freshness=0)
    robot.lose_parameter("/arm/name")
    assert value(http, "/resources/arm/") == {"name": None, "size": 3}
    assert "the parameter /arm/name no longer exists" in unreadable(http, "/resources/arm/", "/arm/name")


def test_a_setter_that_hangs_is_504_and_holds_up_no_reader(arm: MadeUp, serving: Serving) -> None:
    arm.hold("/arm/set_grip")
    http = serving(call_deadline=0.5)
    with ThreadPoolExecutor() as pool:
        late = pool.submit(http.put, "/resources/arm/grip", json=2)
        arm.until(lambda: arm.calls["/arm/set_grip"])
        assert value(http, "/resources/arm/") == {"grip": 1, "label": "red"}
        answer = late.result()
    assert "/arm/set_grip did not respond" in detail(answer, 504)
    arm.release("/arm/set_grip")
    assert http.put("/resources/arm/grip", json=2).status_code == 204
    assert value(http, "/resources/arm/grip") == 2


WHY = {
    "hangs": "did not respond",
    "refuses": "/door/get_lock refused",
    "has died": "cannot be read",
    "is not there": "does not exist",
}
"""Ways in which a state is missing, and their descriptions."""


def test_what_depends_on_a_state_that_cannot_be_read_is_not_on_offer(robot: MadeUp, serving: Serving) -> None:
    lock = robot.variable("/door/lock", "Words", words="open")
    robot.answer("/door/open", "std_srvs/srv/Trigger", success=True)
    robot.parameter("/room/light", True)
    http = serving(freshness=0, read_deadline=0.2)
    mapped(http, DOOR)
    here = f"{http.base_url}resources/"
    for failure, why in WHY.items():
        robot.calls.clear()
        assert objects(http.get("/resources/door/"), f"{LDP}contains") == {f"{here}door/lock", f"{here}door/open"}
        assert value(http, "/resources/room/light") is True
        if failure == "hangs":
            robot.hold("/door/get_lock")
        elif failure == "refuses":
            robot.offer("/door/get_lock", "made_up/srv/GetWords", refuses("rusty"))
        elif failure == "has died":
            robot.break_off("/door/get_lock")
        else:
            robot.withdraw("/door/get_lock")
            robot.withdraw("/door/set_lock")
        whole = http.get("/resources/door/")
        assert objects(whole, f"{LDP}contains") <= {f"{here}door/lock"}
        assert objects(whole, "http://example.org/open") == objects(whole, "http://example.org/room") == set()
        assert "door/open" not in whole.text
        assert whole.headers["cache-control"] == "no-cache"
        refusals = [http.post("/resources/door/open")]
        if failure != "is not there":
            refusals.append(http.put("/resources/door/lock", json="shut"))
        for answer in refusals:
            assert "cannot be read" in detail(answer, 409)
            assert why in detail(answer, 409)
        for path in ("door/open", "room/", "room/light"):
            assert why in detail(http.get(f"/resources/{path}"), 404)
        assert robot.calls["/door/open"] == robot.calls["/door/set_lock"] == 0
        if failure == "hangs":
            robot.release("/door/get_lock")
        else:
            robot.offer("/door/get_lock", "made_up/srv/GetWords", lambda _: lock)
        assert http.post("/resources/door/open", headers=JSON).json() == {"lock": "open"}
        assert value(http, "/resources/room/light") is True


def test_a_value_that_is_no_number_is_within_no_bounds(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/door/gap", "std_msgs/msg/Float64", {"data": 0.25})
    robot.answer("/door/open", "std_srvs/srv/Trigger", success=True)
    http = serving()
    for bound in ("0.5", "1", "5.0e-1"):
        mapped(
            http,
            f"""<#door> a map:ComplexResource ; map:path "/door/" ;
                  map:property [ map:predicate ex:gap ; map:member "gap" ] ;
                  map:action [ map:relation ex:open ; map:service "/door/open" ; map:availableWhen <#narrow> ] .
                <#narrow> a sh:NodeShape ; map:about "/door/" ;
                  sh:property [ sh:path ex:gap ; sh:maxInclusive {bound} ] .""",
        )
        for number, status in ((0.25, 200), ("NaN", 409), ("INF", 409), ("-INF", 200)):
            robot.publishes("/door/gap", {"data": number})
            assert value(http, "/resources/door/") == {"gap": number}
            assert http.post("/resources/door/open").status_code == status, (bound, number)


class Forgetful(MadeUp):
    """A robot whose parameters can be written, but not read afterwards."""

    async def get_parameters(self, names: Any, *, deadline: float) -> Any:
        if self.was_written:
            raise Unreachable("the parameter server does not answer")
        return await super().get_parameters(names, deadline=deadline)

    async def set_parameters(self, values: Any, *, deadline: float) -> None:
        await super().set_parameters(values, deadline=deadline)
        self.was_written = True

    was_written = False


def test_a_write_that_was_done_is_204_where_its_result_cannot_be_shown() -> None:
    for method, path, body, headers in (
        ("PUT", "/parameters/arm/speed", "2", {"Content-Type": "application/json"}),
        ("PATCH", "/parameters/arm/", '{"speed": 2}', MERGE),
    ):
        robot = Forgetful()
        robot.parameter("/arm/speed", 1)
        with served(robot) as http:
            answer = http.request(method, path, content=body, headers={"Prefer": "return=representation", **headers})
            assert (answer.status_code, answer.content, robot.was_written) == (204, b"", True)
            assert "preference-applied" not in answer.headers
            assert http.get("/parameters/arm/speed").status_code in (502, 503)
