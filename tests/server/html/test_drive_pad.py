"""The drive pad in a real browser: the robot's commands while it is pressed, and the standstill when it is not."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from rosld.server.html import forms
from tests.server.robots.made_up import MadeUp, served
from tests.stopping import release
from tests.waiting import until

pytestmark = pytest.mark.slow

STICK = "document.querySelector('.stick')"
WORDS = "document.querySelector('.driving').textContent"
DRIVING = f"{WORDS} === 'Driving'"
TWIST, STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
STILL = {"linear": {"x": 0.0, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}
LIMITS = """@prefix sh: <http://www.w3.org/ns/shacl#> . @prefix vector: <https://w3id.org/rosld/types/geometry_msgs/msg/Vector3#> .
@prefix twist: <https://w3id.org/rosld/types/geometry_msgs/msg/Twist#> .
<#slow> a sh:NodeShape ; sh:targetClass <https://w3id.org/rosld/types/geometry_msgs/msg/Twist> ;
  sh:property [ sh:path twist:linear ; sh:node [ sh:property [ sh:path vector:x ; sh:minInclusive -0.1 ; sh:maxInclusive 0.25 ] ] ] ."""  # fmt: skip  # noqa: E501


def near(one: tuple[float, float], other: tuple[float, float]) -> bool:
    """Whether two speeds are the same up to the precision of a pixel."""
    return all(abs(left - right) < 5e-3 for left, right in zip(one, other, strict=True))


class Base(MadeUp):
    """A base, and its received messages."""

    def __init__(self) -> None:
        super().__init__()
        self.topic("/cmd_vel", TWIST, published=False, heard=True)
        self.topic("/stamped", STAMPED, published=False, heard=True)
        self.topic("/car", "ackermann_msgs/msg/AckermannDriveStamped", published=False, heard=True)
        self.topic("/say", "std_msgs/msg/String", published=False, heard=True)

    def told(self, topic: str = "/cmd_vel") -> list[Any]:
        """Return the messages received on a topic so far."""
        return list(self.sent.get(topic, ()))

    def speeds(self) -> list[tuple[float, float]]:
        """Return the forward and leftward speed of each command so far."""
        return [(each["linear"]["x"], each["angular"]["z"]) for each in self.told()]

    def drives(self) -> tuple[float, float]:
        """Wait for a command that is not zero; return it."""
        return until(
            lambda: next((each for each in reversed(self.speeds()[-1:]) if each != (0.0, 0.0)), None), "motion"
        )

    def stands(self) -> None:
        """Wait until the last command is zero, and the hold is over."""
        until(lambda: self.told()[-1:] == [STILL], "standstill")


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Set a lease that lasts even on a busy machine."""
    monkeypatch.setattr(forms, "LEASE", 4.0)


@pytest.fixture
def base() -> Base:
    return Base()


@pytest.fixture
def http(base: Base) -> Iterator[httpx.Client]:
    with served(base) as client:
        yield client


@pytest.fixture
def pad(tab: Any, http: httpx.Client) -> Any:
    """The tab, scrolled to the pad of `/cmd_vel`."""
    return opened(tab, http, "/cmd_vel")


def opened(tab: Any, http: httpx.Client, topic: str) -> Any:
    tab.open(f"{http.base_url}topics{topic}")
    tab.until(STICK)
    tab.run(f"void {STICK}.scrollIntoView({{block: 'center'}})")
    return tab


def place(tab: Any, left: float, ahead: float) -> dict[str, float]:
    """Return the position of a point of the pad in the window."""
    box = tab.run(f"JSON.stringify({STICK}.getBoundingClientRect())")
    rect = json.loads(box)
    return {
        "x": rect["left"] + rect["width"] * (1 - left) / 2,
        "y": rect["top"] + rect["height"] * (1 - ahead) / 2,
    }


def mouse(tab: Any, kind: str, left: float, ahead: float) -> None:
    at = place(tab, left, ahead)
    tab.send("Input.dispatchMouseEvent", type=kind, button="left", buttons=1, clickCount=1, **at)


def press(tab: Any, left: float = 0.0, ahead: float = 0.999) -> None:
    mouse(tab, "mousePressed", left, ahead)
    tab.until(DRIVING)


def key(tab: Any, kind: str, code: str) -> None:
    name = code if code.startswith("Arrow") else code[-1].lower()
    tab.send("Input.dispatchKeyEvent", type=kind, code=code, key=name)


def is_free(http: httpx.Client) -> bool:
    """Whether nobody holds the topic."""
    return "heldBy" not in http.get("/topics/cmd_vel", headers={"Accept": "text/turtle"}).text


def test_a_pointer_drives_where_it_points_and_letting_go_is_zero(base: Base, http: httpx.Client, pad: Any) -> None:
    press(pad)
    assert near(base.drives(), (0.3, 0.0))
    mouse(pad, "mouseMoved", 1.0, 0.0)
    until(lambda: near(base.speeds()[-1], (0.0, 0.6)), "a turn to the left")
    mouse(pad, "mouseMoved", -0.5, -0.5)
    until(lambda: near(base.speeds()[-1], (-0.15, -0.3)), "backwards to the right")
    assert pad.run("document.querySelector('.figures').textContent") == "-0.15 m/s, -0.30 rad/s"
    mouse(pad, "mouseReleased", -0.5, -0.5)
    base.stands()
    pad.until(f"{WORDS} === 'Standing'")
    until(lambda: is_free(http), "the end of the hold")
    count = len(base.told())
    assert http.put("/topics/cmd_vel", json=STILL).status_code == 204
    assert len(base.told()) == count + 1, "nothing else came"


def test_keys_drive_while_the_pad_has_the_focus(base: Base, pad: Any) -> None:
    up, left = "KeyW", "ArrowLeft"
    key(pad, "keyDown", up)
    assert base.told() == [], "nothing has the focus"
    key(pad, "keyUp", up)
    pad.run(f"{STICK}.focus()")
    key(pad, "keyDown", up)
    pad.until(DRIVING)
    assert near(base.drives(), (0.3, 0.0))
    key(pad, "keyDown", left)
    half = 0.5**0.5
    until(lambda: near(base.speeds()[-1], (0.3 * half, 0.6 * half)), "ahead to the left")
    key(pad, "keyUp", up)
    until(lambda: near(base.speeds()[-1], (0.0, 0.6)), "a turn")
    pad.run(f"{STICK}.blur()")
    base.stands()
    pad.run(f"{STICK}.focus()")
    key(pad, "keyDown", up)
    pad.until(DRIVING)
    key(pad, "keyDown", "Escape")
    base.stands()


def test_a_finger_drives_on_a_phone(base: Base, tab: Any, http: httpx.Client) -> None:
    tab.send("Emulation.setDeviceMetricsOverride", width=390, height=844, deviceScaleFactor=2, mobile=True)
    tab.send("Emulation.setTouchEmulationEnabled", enabled=True)
    pad = opened(tab, http, "/cmd_vel")
    assert pad.run("document.documentElement.scrollWidth") == 390
    assert pad.run(f"{STICK}.getBoundingClientRect().width") >= 200
    small = "[...document.querySelectorAll('.pad input')].filter((each) => each.getBoundingClientRect().height < 24)"
    assert pad.run(f"{small}.length") == 0
    pad.send("Input.dispatchTouchEvent", type="touchStart", touchPoints=[place(pad, 0.0, 0.5)])
    pad.until(DRIVING)
    assert near(base.drives(), (0.15, 0.0))
    scrolled = pad.run("scrollY")
    pad.send("Input.dispatchTouchEvent", type="touchMove", touchPoints=[place(pad, 0.0, 3.0)])
    until(lambda: base.speeds()[-1][0] == pytest.approx(0.3), "as fast as the pad goes")
    assert pad.run("scrollY") == scrolled, "the page does not move under the finger"
    pad.send("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
    base.stands()


def test_the_stick_of_a_game_pad_drives_while_the_pad_has_the_focus(base: Base, pad: Any) -> None:
    pad.run("void (window.axes = [0.05, -0.1])")
    pad.run("void (navigator.getGamepads = () => [null, {connected: true, axes}])")
    pad.run(f"{STICK}.focus()")
    pad.run("void axes.splice(0, 2, 0, -1)")
    pad.until(DRIVING)
    assert near(base.drives(), (0.3, 0.0))
    pad.run("void axes.splice(0, 2, 0.02, 0.1)")
    base.stands()
    pad.run("void axes.splice(0, 2, -1, 0)")
    until(lambda: near(base.speeds()[-1], (0.0, 0.6)), "a turn to the left")
    pad.run("document.querySelector('.pad input').focus()")
    base.stands()


def test_speeds_are_bounded_by_the_sliders_and_by_the_limits_in_force(base: Base, http: httpx.Client, tab: Any) -> None:
    limits = http.put("/shapes/slow", content=LIMITS, headers={"Content-Type": "text/turtle"})
    assert limits.status_code == 201, limits.text
    pad = opened(tab, http, "/cmd_vel")
    slider = "document.querySelector('.pad input')"
    assert pad.run(f"{slider}.max") == "0.25"
    press(pad)
    pad.run(f"{slider}.value = {slider}.max; void {slider}.dispatchEvent(new Event('input'))")
    until(lambda: near(base.speeds()[-1], (0.25, 0.0)), "as fast as the limits let it")
    mouse(pad, "mouseMoved", 0.0, -1.0)
    until(lambda: base.speeds()[-1][0] == pytest.approx(-0.1), "backwards as fast as the limits let it")
    mouse(pad, "mouseReleased", 0.0, -1.0)
    base.stands()
    assert max(speed for speed, _ in base.speeds()) <= 0.25
    assert min(speed for speed, _ in base.speeds()) >= -0.1
    assert pad.run(f"{slider}.nextElementSibling.textContent") == "0.25 m/s"
    pad.until("document.querySelector('.liveness').dataset.state === 'live'")
    assert http.delete("/shapes/slow").status_code == 204
    assert http.put("/topics/cmd_vel", json=STILL).status_code == 204
    pad.until(f"{slider}.max === '1'")


def test_stamped_commands_and_those_of_cars_have_their_own_fields(base: Base, http: httpx.Client, tab: Any) -> None:
    pad = opened(tab, http, "/stamped")
    press(pad, left=0.5, ahead=0.0)
    told = until(lambda: base.told("/stamped")[-1:], "a command")[0]
    assert near((told["twist"]["linear"]["x"], told["twist"]["angular"]["z"]), (0.0, 0.3))
    assert told["header"]["stamp"]["sec"] > 0
    mouse(pad, "mouseReleased", 0.5, 0.0)
    until(lambda: base.told("/stamped")[-1]["twist"] == STILL, "standstill")
    pad = opened(tab, http, "/car")
    assert (
        pad.run("[...document.querySelectorAll('.pad label')].map((each) => each.textContent).join()")
        == "Speed,Steering"
    )
    press(pad, left=-0.5, ahead=0.0)
    told = until(lambda: base.told("/car")[-1:], "a command")[0]["drive"]
    assert near((told["speed"], told["steering_angle"]), (0.0, -0.09))
    mouse(pad, "mouseReleased", -0.5, 0.0)
    until(lambda: base.told("/car")[-1]["drive"]["steering_angle"] == 0.0, "standstill")


# End of a command


def test_leaving_the_page_is_zero(base: Base, http: httpx.Client, pad: Any) -> None:
    press(pad)
    base.drives()
    pad.open(f"{http.base_url}topics/say")
    base.stands()


def test_closing_the_tab_is_zero(base: Base, http: httpx.Client, window: Any) -> None:
    with window.tab() as tab:
        press(opened(tab, http, "/cmd_vel"))
        base.drives()
    base.stands()


def test_a_page_that_dies_is_zero_when_its_lease_is_over(base: Base, http: httpx.Client, window: Any) -> None:
    with window.tab() as tab:
        press(opened(tab, http, "/cmd_vel"))
        base.drives()
        tab.crash()
        base.stands()
    until(lambda: is_free(http), "the end of the hold")


def test_the_network_lost_is_zero_and_nothing_drives_on_when_it_is_back(
    base: Base, http: httpx.Client, pad: Any
) -> None:
    pad.send("Network.enable")
    press(pad)
    base.drives()
    cut = {"latency": 0, "downloadThroughput": -1, "uploadThroughput": -1}
    pad.send("Network.emulateNetworkConditions", offline=True, **cut)
    base.stands()
    pad.until(f"{WORDS}.startsWith('No answer')")
    count = len(base.told())
    pad.send("Network.emulateNetworkConditions", offline=False, **cut)
    mouse(pad, "mouseMoved", 0.5, 0.5)
    pad.until("document.querySelector('.stick').dataset.pressed === undefined")
    assert http.put("/topics/cmd_vel", json=STILL).status_code == 204
    assert len(base.told()) == count + 1
    mouse(pad, "mouseReleased", 0.5, 0.5)
    press(pad)
    base.drives()
    mouse(pad, "mouseReleased", 0.0, 1.0)
    base.stands()


def test_losing_the_focus_the_sight_or_the_pad_is_zero(base: Base, http: httpx.Client, pad: Any) -> None:
    for loses in (
        "dispatchEvent(new Event('blur'))",
        "(Object.defineProperty(document, 'hidden', {value: true, configurable: true}), "
        "document.dispatchEvent(new Event('visibilitychange')))",
        f"{STICK}.dispatchEvent(new PointerEvent('pointercancel', {{pointerId: 1}}))",
        f"{STICK}.closest('section').remove()",
    ):
        mouse(opened(pad, http, "/cmd_vel"), "mouseReleased", 0.0, 0.0)
        press(pad)
        base.drives()
        pad.run(f"void ({loses})")
        base.stands()


def test_a_stop_ends_it_takes_the_pad_away_and_a_release_brings_it_back(
    base: Base, http: httpx.Client, pad: Any
) -> None:
    pad.until("document.querySelector('.liveness').dataset.state === 'live'")
    press(pad)
    base.drives()
    assert http.post("/stop").status_code == 200
    pad.until(f"!{STICK}")
    assert base.told()[-1] == STILL
    assert release(http).status_code == 204
    assert base.told()[-1] == STILL, "nothing drives on"
    pad.until(f"{STICK} && !document.querySelector('main [inert]')")
    mouse(pad, "mouseReleased", 0.0, 1.0)
    pad.run(f"void {STICK}.scrollIntoView({{block: 'center'}})")
    press(pad)
    base.drives()
    mouse(pad, "mouseReleased", 0.0, 1.0)
    base.stands()


def test_a_refusal_is_told_on_the_pad(base: Base, http: httpx.Client, pad: Any) -> None:
    held = http.post("/topics/cmd_vel", params={"lease": 5}, json=STILL)
    assert held.status_code == 201
    mouse(pad, "mousePressed", 0.0, 1.0)
    pad.until(f"{WORDS}.includes('is held')")
    assert pad.run(f"{STICK}.dataset.pressed === undefined")
    assert set(base.speeds()) == {(0.0, 0.0)}
    mouse(pad, "mouseReleased", 0.0, 1.0)
    assert http.delete(held.headers["location"]).status_code == 204
    press(pad)
    mouse(pad, "mouseReleased", 0.0, 1.0)
    base.stands()


# Without a pointer, and without a script


def test_the_pad_and_its_sliders_have_names_and_are_reached_by_the_tab_key(pad: Any) -> None:
    tree = pad.send("Accessibility.getFullAXTree")["nodes"]
    named = {(node["role"]["value"], node["name"]["value"]) for node in tree if node.get("name", {}).get("value")}
    assert {("application", "Drive /cmd_vel"), ("slider", "Speed"), ("slider", "Turn")} <= named
    assert any(node["role"]["value"] == "status" for node in tree)
    described = next(node for node in tree if node["role"]["value"] == "application")
    assert "arrow keys" in described["description"]["value"]
    pad.run(f"{STICK}.focus()")
    reached = []
    for _ in range(2):
        pad.send("Input.dispatchKeyEvent", type="keyDown", key="Tab", code="Tab", windowsVirtualKeyCode=9)
        pad.send("Input.dispatchKeyEvent", type="keyUp", key="Tab", code="Tab", windowsVirtualKeyCode=9)
        reached.append(pad.run("document.activeElement.labels?.[0]?.textContent"))
    assert reached == ["Speed", "Turn"]
    assert pad.run("document.activeElement.getAttribute('aria-valuetext')") == "0.60 rad/s"


def test_without_scripts_a_form_holds_and_its_page_renews_and_ends(base: Base, http: httpx.Client, tab: Any) -> None:
    tab.send("Emulation.setScriptExecutionDisabled", value=True)
    tab.open(f"{http.base_url}topics/cmd_vel")
    tab.send("Emulation.setScriptExecutionDisabled", value=False)
    assert tab.run("document.querySelector('.pad').checkVisibility()") is False
    form = "document.querySelector('.hold form')"
    assert tab.run(f"!{form}.closest('details').open")
    tab.run(f"void ({form}.elements['linear.x'].value = '0.2')")
    tab.leave(f"{form}.requestSubmit()")
    assert tab.run("location.pathname").startswith("/holds/")
    assert base.drives() == (0.2, 0.0)
    renew = "[...document.querySelectorAll('button')].find((each) => each.textContent === 'Renew')"
    tab.leave(f"{renew}.click()")
    assert tab.run("location.pathname").startswith("/holds/")
    tab.leave(f"{renew.replace('Renew', 'End')}.click()")
    base.stands()
    assert is_free(http)
