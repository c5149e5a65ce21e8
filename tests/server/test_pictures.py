"""Pictures of topics over HTTP: negotiated like other formats, refused with reasons, in motion for many clients."""

from __future__ import annotations

import base64
import html
import re
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import cv2
import httpx
import numpy as np
import pytest

from rosld.server.pictures.picture import draw_sample
from tests.waiting import until

pytestmark = pytest.mark.slow

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CAMERA = "topics/camera"
BROWSER = "text/html,application/xhtml+xml,application/xml;q=0.9,image/avif,image/webp,image/apng,*/*;q=0.8"
IMG = "image/avif,image/webp,image/apng,image/svg+xml,image/*,*/*;q=0.8"
STAMP = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "eye"}


def image(values: np.ndarray, encoding: str = "bgr8", **changes: Any) -> dict[str, Any]:
    height, width = values.shape[:2]
    data = base64.b64encode(values.tobytes()).decode()
    return {"header": STAMP, "height": height, "width": width, "encoding": encoding, "is_bigendian": 0,
            "step": values.nbytes // height, "data": data, **changes}  # fmt: skip


def frame(number: int, size: tuple[int, int] = (48, 64)) -> np.ndarray:
    """Return a picture that encodes its number as its colour."""
    return np.full((*size, 3), (number * 20 % 256, 40, 200), np.uint8)


def decoded(file: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(file, np.uint8), cv2.IMREAD_UNCHANGED)


def get(http: httpx.Client, path: str = CAMERA, accept: str = "*/*", **headers: str) -> httpx.Response:
    return http.get(path, headers={"Accept": accept, **headers})


@pytest.fixture
def camera(robot: Any) -> Any:
    """A robot with a camera that shows frame 0, others that cannot be drawn, and one that is silent."""
    robot.topic("/camera", IMAGE, image(frame(0)))
    robot.topic("/odd", IMAGE, image(frame(0), "yuv420"))
    robot.topic("/short", IMAGE, image(frame(0), step=1000))
    robot.topic("/huge", IMAGE, image(frame(0), width=2**31, height=2**31))
    robot.topic("/wide", IMAGE, image(np.zeros((1, 70_000), np.uint8), "mono8"))
    robot.topic("/tall", IMAGE, image(np.zeros((70_000, 2), np.uint8), "mono8"))
    robot.topic("/empty", IMAGE, image(np.zeros((1, 1), np.uint8), "mono8", width=0, height=0, step=0, data=""))
    robot.topic("/words", "std_msgs/msg/String", {"data": "<img>"})
    robot.topic("/silent", IMAGE, published=False)
    file = cv2.imencode(".jpg", frame(3))[1].tobytes()
    robot.topic("/file", COMPRESSED, {"header": STAMP, "format": "jpeg", "data": base64.b64encode(file).decode()})
    return robot


def test_a_picture_is_one_of_the_representations(camera: Any, serving: Any) -> None:
    http = serving()
    for accept, media_type in (
        ("image/png", "image/png"), ("image/jpeg", "image/jpeg"), (IMG, "image/jpeg"),
        ("image/jpeg;q=0.2, image/png;q=0.3", "image/png"), ("text/turtle;q=0.1, image/png;q=0.2", "image/png"),
        ("text/turtle;q=0.3, image/png;q=0.2", "text/turtle"), (BROWSER, "text/html"), ("*/*", "text/turtle"),
    ):  # fmt: skip
        answer = get(http, accept=accept)
        assert answer.status_code == 200, answer.text
        assert (answer.headers["content-type"].partition(";")[0], answer.headers["vary"]) == (media_type, "Accept")
    png = get(http, accept="image/png")
    assert (decoded(png.content) == frame(0)).all()
    jpeg = get(http, f"{CAMERA}?format=jpeg&width=32")
    assert decoded(jpeg.content).shape == (24, 32, 3)
    assert np.abs(decoded(jpeg.content).astype(int) - frame(0)[:24, :32]).max() < 4
    tags = {png.headers["etag"], jpeg.headers["etag"], get(http).headers["etag"]}
    assert len(tags) == 3
    assert get(http, accept="image/png", **{"If-None-Match": png.headers["etag"]}).status_code == 304
    camera.publishes("/camera", image(frame(9)))
    again = get(http, accept="image/png", **{"If-None-Match": png.headers["etag"]})
    assert (decoded(again.content) == frame(9)).all()
    assert http.head(CAMERA, headers={"Accept": "image/png"}).headers["content-length"] == str(len(again.content))


def test_a_file_passes_as_it_came_unless_another_is_asked_for(camera: Any, serving: Any) -> None:
    http = serving()
    sent = http.get("topics/file?field=data").content
    assert get(http, "topics/file", "image/jpeg").content == sent
    assert get(http, "topics/file", "image/png").content.startswith(b"\x89PNG")
    assert decoded(get(http, "topics/file?format=jpeg&width=16").content).shape == (12, 16, 3)


def test_a_message_that_cannot_be_drawn_is_refused_in_words(camera: Any, serving: Any) -> None:
    http = serving()
    for path, status, words in (
        ("topics/odd?format=png", 406, "encoding is not supported; the supported ones are rgb8"),
        ("topics/short?format=jpeg", 422, "truncated"), ("topics/huge?format=mjpeg", 422, "36,000,000"),
        ("topics/words?format=png", 406, "std_msgs/msg/String: only sensor_msgs/msg/Image"),
        ("topics/silent?format=jpeg", 404, "no message yet"), ("topics/none?format=jpeg", 404, "no topic"),
        (f"{CAMERA}?format=jpeg&width=0", 400, "from 1 to"), (f"{CAMERA}?format=jpeg&range=4", 400, "two distances"),
        (f"{CAMERA}?format=mjpeg&rate=x", 400, "rate"),
    ):  # fmt: skip
        answer = get(http, path)
        assert (answer.status_code, words in answer.json()["detail"]) == (status, True), (path, answer.text)
    for path, size in (("topics/wide", "70000 by 1"), ("topics/tall", "2 by 70000")):
        for form in ("jpeg", "mjpeg"):
            words = f"{size} pixels, but a JPEG has at most 65500 per side: ask for image/png"
            assert words in get(http, f"{path}?format={form}").json()["detail"]
        assert get(http, f"{path}?format=png").status_code == 200
        assert get(http, f"{path}?format=jpeg&width=1").status_code == 200
    for form in ("jpeg", "png", "mjpeg"):
        answer = get(http, f"topics/empty?format={form}")
        assert (answer.status_code, "nothing to show" in answer.text) == (422, True)
    assert "image/png" in get(http, accept="image/webp").json()["detail"]
    assert get(http, "topics/words", "image/png").status_code == 406
    page = get(http, "topics/odd", BROWSER).text
    assert "Images of the encoding yuv420 cannot be shown." in page
    assert '<img src="?format=jpeg' not in page


@contextmanager
def connected(http: httpx.Client, query: str) -> Iterator[socket.socket]:
    """Return a motion stream as the bytes of a connection."""
    url = http.base_url
    with socket.create_connection((url.host, url.port or 80), timeout=60) as found:
        head = f"GET /{CAMERA}?{query} HTTP/1.1\r\nHost: {url.host}:{url.port}\r\n"
        found.sendall(f"{head}Accept: multipart/x-mixed-replace, */*;q=0.1\r\n\r\n".encode())
        yield found


class Viewer:
    """Reader of a motion stream on its own thread, with the received pictures."""

    def __init__(self, http: httpx.Client, query: str) -> None:
        self.files: list[bytes] = []
        self._http, self._query = http, query
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        with connected(self._http, self._query) as connection:
            rest = b""
            while chunk := connection.recv(65536):
                rest += chunk
                while (start := rest.find(b"\xff\xd8\xff")) >= 0 and (end := rest.find(b"\xff\xd9", start)) >= 0:
                    self.files.append(rest[start : end + 2])
                    rest = rest[end + 2 :]

    def has(self, number: int, size: tuple[int, int] = (48, 64)) -> bool:
        """Whether the last picture is that of a number."""
        return bool(self.files) and np.abs(decoded(self.files[-1]).astype(int) - frame(number, size)).max() < 6


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return the drawn picture."""
    found: list[Any] = []

    def counting(*given: Any) -> Any:
        found.append(given)
        return draw_sample(*given)

    monkeypatch.setattr("rosld.server.pictures.picture.draw_sample", counting)
    return found


def test_many_viewers_of_one_motion_share_its_drawing(camera: Any, serving: Any, drawn: list[Any]) -> None:
    http = serving()
    viewers = [Viewer(http, "rate=100&width=64") for _ in range(10)]
    for number in range(6):
        camera.publishes("/camera", image(frame(number)))
        until(lambda number=number: all(each.has(number) for each in viewers), f"picture {number} at all viewers")
    assert len(drawn) <= 7
    assert all(len(each.files) >= 6 for each in viewers)


def thumbnails(http: httpx.Client, path: str) -> dict[str, str]:
    """Return the small pictures on a page: their URLs, by the paths of their topics."""
    page = get(http, path, BROWSER).text
    found = re.findall(r'<a class="thumbnail" href="/([^"]+)"[^>]*><img src="([^"]+)"[^>]* loading="lazy"', page)
    return {topic: html.unescape(source) for topic, source in found}


def test_lists_show_small_pictures_of_subscribed_topics_that_can_be_drawn(camera: Any, serving: Any) -> None:
    camera.topic("/map_image", "nav_msgs/msg/OccupancyGrid", {"info": {"width": 2, "height": 1}, "data": [0, 100]})
    camera.topic("/video_image", COMPRESSED, {"header": STAMP, "format": "h264", "data": "AAAAAQ=="})
    http = serving()
    assert thumbnails(http, "topics/") == {}
    for topic in ("camera", "odd", "huge", "silent", "file", "map_image", "video_image", "words"):
        http.get(f"topics/{topic}")
    for path in ("topics/", "find?q=image"):
        found = thumbnails(http, path)
        assert found.keys() == {"topics/camera", "topics/file", "topics/map_image"}
        assert found["topics/map_image"].startswith("/topics/map_image?format=png&width=192&v=")
        assert "encoding yuv420" in get(http, path, BROWSER).text
    assert {get(http, source, IMG).status_code for source in found.values()} == {200}


def test_a_small_picture_is_drawn_once_and_changes_its_address_with_its_message(
    camera: Any, serving: Any, drawn: list[Any]
) -> None:
    http = serving()
    http.get(CAMERA)
    first = thumbnails(http, "topics/")["topics/camera"]
    for _ in range(3):
        assert thumbnails(http, "topics/")["topics/camera"] == first
        assert (decoded(get(http, first, IMG).content).shape) == (48, 64, 3)
    assert len(drawn) == 1
    camera.publishes("/camera", image(frame(7), width=64))
    until(lambda: thumbnails(http, "topics/")["topics/camera"] != first, "another address")


def test_a_topic_that_may_not_be_read_has_no_small_picture(camera: Any, serving: Any, tmp_path: Path) -> None:
    rules = tmp_path / "auth.toml"
    rules.write_text(
        '[[rule]]\nagents = ["anybody"]\nmodes = ["read"]\npaths = ["/find", "/topics/**"]\n'
        '[[rule]]\nagents = ["anybody"]\nmodes = ["read"]\npaths = ["/topics/camera"]\ndeny = true\n'
    )
    http = serving(auth=rules, subscribe=("/camera", "/file"))
    for path in ("topics/", "find?q=image"):
        until(lambda path=path: thumbnails(http, path).keys() == {"topics/file"}, "the picture that may be seen")
        assert "topics/camera" not in get(http, path, BROWSER).text


def test_a_reader_that_takes_nothing_delays_nobody(camera: Any, serving: Any) -> None:
    http, size = serving(), (480, 640)
    noise = np.random.default_rng(1).integers(0, 255, (*size, 3), np.uint8)
    with ExitStack() as connections:
        for _ in range(3):
            connections.enter_context(connected(http, "rate=100"))
        viewer = Viewer(http, "rate=100")
        for number in range(12):
            before = len(viewer.files)
            camera.publishes("/camera", image(noise))
            until(lambda before=before: len(viewer.files) > before, f"picture {number}")
        camera.publishes("/camera", image(frame(7, size)))
        until(lambda: viewer.has(7, size), "the last picture")
    assert get(http, accept="image/png").status_code == 200


def test_a_recorded_message_is_drawn(camera: Any, serving: Any) -> None:
    http = serving(history=("/camera",))
    for number in (1, 2):
        camera.publishes("/camera", image(frame(number)))
        until(lambda number=number: (newest(http) == frame(number)).all(), f"picture {number}")
        time.sleep(0.002)  # times are rounded to the millisecond

    def is_drawn(number: int) -> bool:
        """Whether one of the recorded messages is drawn as this frame."""
        answers = [http.get(f"bags/history/messages/{index}?format=png") for index in range(4)]
        return any(each.status_code == 200 and (decoded(each.content) == frame(number)).all() for each in answers)

    until(lambda: is_drawn(1) and is_drawn(2), "both pictures in the history")
    past = http.get("topics/camera?at=-0.0001&format=png")
    assert (decoded(past.content) == frame(2)).all()
    assert http.get("topics/camera?at=-0.0001&format=mjpeg").status_code == 406
    page = http.get("topics/camera?at=-0.0001", headers={"Accept": "text/html"}).text
    assert "?at=-0.0001&amp;format=jpeg" in page
    assert "data-motion" not in page


def newest(http: httpx.Client) -> np.ndarray:
    return decoded(http.get(f"{CAMERA}?format=png").content)
