"""Mapper3D's map on the topics and services of `octomap_server`, with the names of its ROS 1 and ROS 2 releases."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bridge.modules.host import Host
from bridge.modules.services import Answer
from navigation.clouds import POINT_CLOUD
from navigation.map2d_server.maps3d import GET, OCTOMAP, octomap_message
from navigation.mapper3d.section import Mapper3DSection
from navigation.mapper3d.space import Space
from yarp_compat.octomap import Octomap

BOX, EMPTY = "octomap_msgs/srv/BoundingBoxQuery", "std_srvs/srv/Empty"

_AGAIN = 5  # periods after which an unchanged map is published again, for new subscribers
_CENTERS = "/octomap_point_cloud_centers"


class OctomapServer:
    """The topics and services of the map. Used only on the module's thread."""

    def __init__(self, host: Host, section: Mapper3DSection, space: Space) -> None:
        self._clock, self._frame, self._space = host.clock, section.map_frame, space
        node = host.node
        self._maps = {binary: node.publisher(_name(binary), OCTOMAP) for binary in (True, False)}
        self._centers = node.publisher(_CENTERS, POINT_CLOUD)
        self._silent = 0
        for binary in (True, False):
            node.server(_name(binary), GET, lambda _, answer, b=binary: answer({"map": self.message(b)}))  # type: ignore[misc]
        node.server("/octomap_server/clear_bbx", BOX, self._clear_box)
        node.server("/octomap_server/reset", EMPTY, self._reset)

    def publish(self, *, changed: bool) -> None:
        """Publish the map if it has subscribers and has changed, or after some periods."""
        self._silent += 1
        if not changed and self._silent < _AGAIN:
            return
        self._silent = 0
        for binary, out in self._maps.items():
            out.offer(lambda out=out, binary=binary: out.encoded(self.message(binary)))  # type: ignore[misc]
        self._centers.offer(lambda: self._centers.encoded(cloud_message(self._header(), self._space.occupied())))

    def message(self, binary: bool) -> dict[str, Any]:
        """Return the map as ``octomap_msgs/Octomap``."""
        return octomap_message(Octomap.of(self._space.tree(), binary=binary), self._header())

    def _header(self) -> dict[str, Any]:
        now = self._clock.now_ns()
        return {"stamp": {"sec": now // 10**9, "nanosec": now % 10**9}, "frame_id": self._frame}

    def _clear_box(self, request: dict[str, Any], answer: Answer) -> None:
        low, high = (np.array([request[end][axis] for axis in "xyz"]) for end in ("min", "max"))
        self._space.clear_box(low, high)
        answer({})

    def _reset(self, _request: dict[str, Any], answer: Answer) -> None:
        self._space.clear()
        answer({})


def _name(binary: bool) -> str:
    return f"/octomap_{'binary' if binary else 'full'}"


def cloud_message(header: dict[str, Any], points: NDArray[np.float32]) -> dict[str, Any]:
    """Return points (n, 3) as ``sensor_msgs/msg/PointCloud2``."""
    fields = [{"name": name, "offset": 4 * axis, "datatype": 7, "count": 1} for axis, name in enumerate("xyz")]
    return {
        "header": header, "height": 1, "width": len(points), "fields": fields, "is_bigendian": False, "point_step": 12,
        "row_step": 12 * len(points), "data": points.astype("<f4").reshape(-1).view(np.uint8), "is_dense": True,
    }  # fmt: skip
