"""The picture on the page of a topic in a real browser: in motion while it is looked at, still when paused."""

from __future__ import annotations

from typing import Any

import httpx

from tests.server.html.test_live_pages import LIVE
from tests.server.test_pictures import IMAGE, frame, image

IMG = "document.querySelector('.picture img')"
COLOUR = f"""(() => {{
  const canvas = new OffscreenCanvas(1, 1).getContext("2d");
  canvas.drawImage({IMG}, 0, 0, 1, 1);
  return canvas.getImageData(0, 0, 1, 1).data[2];
}})()"""


def blue(number: int) -> str:
    """Whether the picture has the colour of a frame."""
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


def test_an_encoding_that_is_no_text_stays_text(robot: Any, serving: Any) -> None:
    robot.topic("/camera", IMAGE, image(frame(1), "<script>alert(1)</script>"))
    http: httpx.Client = serving()
    http.get("topics/camera")
    page = http.get("topics/camera", headers={"Accept": "text/html"}).text
    assert "Images of the encoding &lt;script&gt;" in page
    assert "<script>alert" not in page
