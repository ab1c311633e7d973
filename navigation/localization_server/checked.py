"""Checks what a source of poses returns: an error in a user's class must not leave an old pose in use."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from bridge.modules.step_failures import described
from navigation.localization_server.estimate import Floats, LocalizationStatus, PoseEstimate, unknown
from navigation.localization_server.sources import PoseSource, Start
from navigation.pose import Pose
from yarp_compat.dev.mapgrid import MapGrid2D

_NOWHERE = np.empty((0, 3))
_DOUBT = 2.0
"""Seconds for which the pose is unknown after a callback has failed: the source may have missed its data."""


class CheckedSource:
    """Queries a source of poses; if it raises an exception or returns invalid values, the pose is unknown.

    Used on the module's thread. Each different error is logged once.
    """

    def __init__(self, source: PoseSource, name: str, log: logging.LoggerAdapter[Any] | logging.Logger) -> None:
        self._source, self._name, self._log = source, name, log
        self._logged = ""
        self._failed, self._failed_at = "", -math.inf
        self.without_map = ""  # why the source could not switch to the current map

    def use_map(self, grid: MapGrid2D, start: Start | None) -> None:
        """Switch to another map; raises `RuntimeError`. Until that succeeds, a pose on the previous map is not used."""
        self.without_map = ""
        try:
            self._source.use_map(grid, start)
        except Exception as err:
            if start is None or not isinstance(err, RuntimeError):  # else the source refuses only the initial pose
                self.without_map = f"use_map() of {self._name}: {type(err).__name__}: {err}"
            raise RuntimeError(self.without_map or str(err)) from err

    def initial(self, pose: Pose, covariance: Floats | None) -> None:
        """Start at a pose; raises `RuntimeError`."""
        try:
            self._source.initial(pose, covariance)
        except RuntimeError:
            raise
        except Exception as err:
            self.fail(err)
            raise RuntimeError(f"initial() of {self._name}: {type(err).__name__}: {err}") from err

    def fail(self, error: BaseException) -> None:
        """Report an unknown pose for `_DOUBT`, because a callback has failed."""
        self._failed, self._failed_at = f"LocalizationServer failed: {described(error)}", time.monotonic()

    @property
    def _doubt(self) -> str:
        return self.without_map or (self._failed if time.monotonic() - self._failed_at < _DOUBT else "")

    def estimate(self) -> PoseEstimate:
        """Return the source's estimate, or why it cannot be used."""
        if doubt := self._doubt:
            return unknown(doubt, LocalizationStatus.ERROR)
        estimate, error = self._ask("estimate", self._source.estimate, _estimate_problem)
        return unknown(error, LocalizationStatus.ERROR) if estimate is None else estimate

    def correction(self) -> Pose | None:
        """Return the pose of the odometry frame on the map; None if it is unknown or invalid."""
        if self._doubt:
            return None
        pose: Pose | None = self._ask("correction", self._source.correction, _pose_problem)[0]
        return pose

    def cloud(self) -> Floats:
        """Return the possible poses; none if they are invalid."""
        cloud = self._ask("cloud", self._source.cloud, _cloud_problem)[0]
        return _NOWHERE if cloud is None else cloud

    def _ask(self, what: str, call: Callable[[], Any], problem: Callable[[Any], str]) -> tuple[Any, str]:
        """Return the answer, or None and the error."""
        error: Exception | None = None
        try:
            value = call()
            text = problem(value)
        except Exception as err:
            value, text, error = None, f"{type(err).__name__}: {err}", err
        if not text:
            return value, ""
        text = f"{what}() of {self._name}: {text}"
        if text != self._logged:
            self._logged = text
            self._log.error("%s", text, exc_info=error)
        return None, text


def _estimate_problem(estimate: Any) -> str:
    if not isinstance(estimate, PoseEstimate):
        return f"returned {type(estimate).__name__} instead of a PoseEstimate"
    if estimate.pose is None:
        if estimate.status is LocalizationStatus.OK:
            return "the pose is None, but the status is 'localized_ok'"
        return ""
    if np.shape(estimate.covariance) != (3, 3) or not np.isfinite(estimate.covariance).all():
        return f"the covariance must have 3 x 3 finite numbers, not {estimate.covariance!r}"
    return _pose_problem(estimate.pose)


def _pose_problem(pose: Any) -> str:
    if pose is None:
        return ""
    if not isinstance(pose, Pose):
        return f"returned {type(pose).__name__} instead of a Pose"
    return "" if np.isfinite(pose[:3]).all() else f"the pose is not finite: {pose.x:g}, {pose.y:g}, {pose.theta:g}"


def _cloud_problem(cloud: Any) -> str:
    shape = np.shape(cloud)
    if len(shape) != 2 or shape[1] != 3:
        return f"possible poses must have the shape (n, 3), not {shape}"
    return "" if np.isfinite(cloud).all() else "possible poses are not finite"
