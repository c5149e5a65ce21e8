"""The picture on the page of a topic in a real browser: moving while it is visible, still when paused."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from tests.server.html.test_live_pages import LIVE
from tests.server.test_pictures import IMAGE, frame, image
from tests.waiting import until

pytestmark = pytest.mark.slow

IMG = "document.querySelector('.picture img')"
COLOUR = f"""(() => {{
  const canvas = new OffscreenCanvas(1, 1).getContext("2d");
  canvas.drawImage({IMG}, 0, 0, 1, 1);
  return canvas.getImageData(0, 0, 1, 1).data[2];
}})()"""


def blue(number: int) -> str:
    """Return whether the picture has the colour of a frame."""
    return f"Math.abs({COLOUR} - {frame(number)[0, 0, 0]}) < 8"


def test_a_picture_moves_while_it_is_looked_at(tab: Any, robot: Any, serving: Any) -> None:
    robot.topic("/camera", IMAGE, image(frame(1)))
    http = serving()
    url = f"{http.base_url}topics/camera"
    http.get(url)
    page = http.get(url, headers={"Accept": "text/html"}).text
    assert 'src="?format=jpeg&amp;width=960"' in page
    tab.open(url)
    tab.until(f"{IMG}.complete && {IMG}.naturalWidth === 64")
    tab.until(f"{LIVE} && {IMG}.dataset.moving === 'yes'")
    for number in (3, 5, 8):
        robot.publishes("/camera", image(frame(number)))
        tab.until(blue(number))
    tab.run("document.querySelector('.liveness button').click()")
    tab.until(f"{IMG}.src.includes('format=jpeg') && {IMG}.complete")
    robot.publishes("/camera", image(frame(10)))
    assert tab.run(blue(8))
    tab.run("document.querySelector('.liveness button').click()")
    tab.until(blue(10))


def test_a_time_of_a_simulated_clock_has_no_age(tab: Any, robot: Any, serving: Any) -> None:
    robot.topic("/imu", "sensor_msgs/msg/Imu", {"header": {"stamp": {"sec": 78, "nanosec": 0}, "frame_id": ""}})
    http: httpx.Client = serving(subscribe=("/imu",))
    tab.open(f"{http.base_url}topics/imu")
    tab.until("document.querySelector('.facts time[data-ago]')")
    assert tab.run("document.querySelector('time[datetime^=\"1970\"]').hasAttribute('data-ago')") is False


def test_an_encoding_that_is_no_text_stays_text(robot: Any, serving: Any) -> None:
    robot.topic("/camera", IMAGE, image(frame(1), "<script>alert(1)</script>"))
    http: httpx.Client = serving()
    http.get("topics/camera")
    page = http.get("topics/camera", headers={"Accept": "text/html"}).text
    assert "Images of the encoding &lt;script&gt;" in page
    assert "<script>alert" not in page


SMALL = "[...document.querySelectorAll('.thumbnail img')]"
FETCHED = (
    "performance.getEntriesByType('resource').map((each) => each.name).filter((each) => each.includes('width=192'))"
)
ASKED = f"new Set({FETCHED})"


def test_a_list_fetches_the_small_pictures_that_are_seen_and_those_anew_that_changed(
    tab: Any, robot: Any, serving: Any
) -> None:
    for number in range(36):
        robot.topic(f"/camera_{number:02}", IMAGE, image(frame(1)))
        robot.topic(f"/words_{number:02}", "std_msgs/msg/String", {"data": ""})
    http = serving(subscribe=("/*",))
    until(lambda: http.get("topics/", headers={"Accept": "text/html"}).text.count('loading="lazy"') == 36, "pictures")
    tab.send("Emulation.setDeviceMetricsOverride", width=390, height=500, deviceScaleFactor=1, mobile=True)
    tab.open(f"{http.base_url}topics/")
    tab.run("document.querySelectorAll('details').forEach((each) => { each.open = true; })")
    tab.until(f"{LIVE} && {SMALL}[0].complete && {SMALL}[0].naturalWidth === 64")
    assert tab.run(f"{SMALL}.length") == 36
    assert tab.run(f"{SMALL}[35].naturalWidth") == 0
    first, last = (tab.run(f"{SMALL}[{number}].src") for number in (0, 35))
    robot.publishes("/camera_35", image(frame(5)))
    robot.publishes("/camera_00", image(frame(5)))
    tab.until(f"{SMALL}[0].src !== '{first}' && {ASKED}.has({SMALL}[0].src) && {SMALL}[0].complete")
    tab.until(f"{SMALL}[35].src !== '{last}'")
    assert tab.run(f"{SMALL}[35].naturalWidth") == 0
    assert tab.run("document.documentElement.scrollWidth") <= 390
