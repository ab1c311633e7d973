"""Where the robot was last, kept over restarts, as amcl keeps it: who begins again need not be told again."""

from __future__ import annotations

import json
import math
import os
import time
from pathlib import Path

from bridge.routing.processes import process_name
from navigation.pose import Pose, wrapped

_MOVED, _TURNED = 0.05, math.radians(3.0)
_EVERY = 2.0
"""Seconds between two writes, at least."""


class Memory:
    """One file.

    Args:
        folder: the module's own.
    """

    def __init__(self, folder: Path) -> None:
        self._file = folder / "pose.json"
        self._kept: tuple[str, Pose] | None = None
        self._written = -math.inf

    def keep(self, map_name: str, pose: Pose, *, now: bool = False) -> None:
        """Keep a pose, where the robot has moved since; ``now``: however short ago the last was kept.

        Raises:
            OSError: it cannot be written.
        """
        if self._kept is not None and not self._far(map_name, pose, self._kept):
            return
        if not now and time.monotonic() - self._written < _EVERY:
            return
        self._kept, self._written = (map_name, pose), time.monotonic()
        new = self._file.with_suffix(".new")
        new.write_text(json.dumps({"map": map_name, "pose": pose[:3], "run": _run()}), encoding="utf-8")
        new.replace(self._file)

    def recall(self, map_name: str, *, of_this_run: bool) -> Pose | None:
        """The pose that was kept on a map; None where there is none.

        Args:
            map_name: the map in use.
            of_this_run: only one that was kept since the daemon began, so that nobody moved the robot since.
        """
        try:
            kept = json.loads(self._file.read_text(encoding="utf-8"))
            x, y, theta = map(float, kept["pose"])
        except (OSError, ValueError, KeyError, TypeError):
            return None
        if kept.get("map") != map_name or (of_this_run and kept.get("run") != (_run() or None)):
            return None
        return Pose(x, y, theta) if math.isfinite(x + y + theta) else None

    @staticmethod
    def _far(map_name: str, pose: Pose, kept: tuple[str, Pose]) -> bool:
        turned = abs(wrapped(pose.theta - kept[1].theta))
        return map_name != kept[0] or pose.distance(kept[1]) > _MOVED or turned > _TURNED


def _run() -> str:
    """The daemon, by more than its number: that is 1 in every container. "" where the system does not tell."""
    return process_name(os.getppid())
