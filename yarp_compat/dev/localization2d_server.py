"""A localiser as clients of ILocalization2D know it: what YARP's ``localization2D_nws_yarp`` makes of a device.

Its port answers by ``Server(Localization2DServer(device))``. Metres and degrees.
"""

# ruff: noqa: D102 - the interface says what each does, and its names are YARP's

from __future__ import annotations

import math
from typing import Any

from yarp_compat.dev.device_calls import DeviceCalls
from yarp_compat.dev.ilocalization2d import Covariance, ILocalization2DMsgs, LocalizationStatusEnum
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.odometry import OdometryData
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnCode, ReturnValue
from yarp_compat.sig.matrix import Matrix

_STATUS = "localization_status_"
_NOT_KNOWN = "it is not known where the robot is"


class Localization2DServer(ILocalization2DMsgs):
    """Answers with a device.

    Args:
        device: any object with the methods of YARP's ILocalization2D, or some of them; see `DeviceCalls`. They run on
            the threads of the connections, several at a time. ``getLocalizationStatus`` returns a status or its name
            (``localized_ok``); ``getCurrentPosition`` a location and its covariance (a 3x3 array or matrix, or None:
            zeros are sent); ``setInitialPose`` gets a location and an array of 3x3, or None where none was sent.
    """

    def __init__(self, device: object) -> None:
        super().__init__()
        self._calls = DeviceCalls(device)

    def start_localization_service_RPC(self) -> ReturnValue:
        return self._calls.done("startLocalizationService")

    def stop_localization_service_RPC(self) -> ReturnValue:
        return self._calls.done("stopLocalizationService")

    def get_localization_status_RPC(self) -> tuple[ReturnValue, LocalizationStatusEnum]:
        status = self._calls.found("getLocalizationStatus", lacking="there is no status")
        if isinstance(status, str):
            status = LocalizationStatusEnum[_STATUS + status.removeprefix(_STATUS)]
        return OK, status

    def get_estimated_poses_RPC(self) -> tuple[ReturnValue, list[Map2DLocation]]:
        return OK, self._calls.found("getEstimatedPoses", lacking="there are no particles")

    def get_current_position1_RPC(self) -> tuple[ReturnValue, Map2DLocation]:
        return OK, self._position()[0]

    def get_current_position2_RPC(self) -> tuple[ReturnValue, Map2DLocation, Covariance]:
        return OK, *self._position()

    def get_estimated_odometry_RPC(self) -> tuple[ReturnValue, OdometryData]:
        return OK, self._calls.found("getEstimatedOdometry", lacking="there is no odometry")

    def set_initial_pose1_RPC(self, loc: Map2DLocation) -> ReturnValue:
        return self._placed(loc, None)

    def set_initial_pose2_RPC(self, loc: Map2DLocation, cov: Matrix) -> ReturnValue:
        return self._placed(loc, cov.numpy() if cov.numpy().size else None)

    def _position(self) -> tuple[Map2DLocation, Any]:
        location, covariance = self._calls.found("getCurrentPosition", lacking=_NOT_KNOWN)
        return location, covariance

    def _placed(self, loc: Map2DLocation, covariance: Any) -> ReturnValue:
        numbers = (loc.x, loc.y, loc.theta, *(() if covariance is None else covariance.ravel()))
        if not all(map(math.isfinite, numbers)):
            raise CallFailed(ReturnCode.METHOD_FAILED, "the pose or its covariance has numbers that are not finite")
        if covariance is not None and covariance.diagonal().min() < 0.0:
            raise CallFailed(ReturnCode.METHOD_FAILED, "the pose's covariance has variances below zero")
        return self._calls.done("setInitialPose", loc, covariance)
