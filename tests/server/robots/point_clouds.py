"""Point clouds as JSON, for simulated robots."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

CLOUD = "sensor_msgs/msg/PointCloud2"


def cloud_message(points: np.ndarray, **changes: Any) -> dict[str, Any]:
    """Return a cloud of rows of x, y and z."""
    fields = [{"name": name, "offset": 4 * at, "datatype": 7, "count": 1} for at, name in enumerate("xyz")]
    data = base64.b64encode(points.astype("<f4").tobytes()).decode()
    return {"header": {"frame_id": "lidar"}, "height": 1, "width": len(points), "fields": fields, "point_step": 12,
            "row_step": 12 * len(points), "data": data, **changes}  # fmt: skip
