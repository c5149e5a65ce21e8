"""The rover's camera as pictures, on each kind of robot, read by OpenCV."""

from __future__ import annotations

import base64

import cv2
import numpy as np

from tests.rover.rovers import Rover
from tests.waiting import until

CAMERA = "/topics/camera/image_raw"


def decoded(file: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(file, np.uint8), cv2.IMREAD_COLOR)


def test_the_camera_is_seen_as_it_is(rover: Rover) -> None:
    def is_same() -> bool:
        """The picture has the pixels of the message; the rover may just have moved."""
        file = rover.http.get(CAMERA, headers={"Accept": "image/png"}).content
        raw = rover.hear("/camera/image_raw")
        data = np.frombuffer(base64.b64decode(raw["data"]), np.uint8).reshape(raw["height"], raw["width"], 3)
        return bool((decoded(file)[:, :, ::-1] == data).all())

    until(is_same, "a picture with the pixels of the message")
    jpeg = rover.http.get(f"{CAMERA}?width=80", headers={"Accept": "image/jpeg"})
    assert decoded(jpeg.content).shape == (60, 80, 3)
    with rover.http.stream("GET", f"{CAMERA}?format=mjpeg&rate=20") as stream:
        assert stream.headers["content-type"] == "multipart/x-mixed-replace; boundary=rosld-picture"
        seen = b""
        for chunk in stream.iter_bytes():
            seen += chunk
            if seen.count(b"\r\n--rosld-picture\r\n") >= 3:
                break
    parts = seen.split(b"--rosld-picture\r\n")[1:4]
    for part in parts:
        head, _, file = part.partition(b"\r\n\r\n")
        assert head.startswith(b"Content-Type: image/jpeg\r\n")
        assert decoded(file).shape == (120, 160, 3)
