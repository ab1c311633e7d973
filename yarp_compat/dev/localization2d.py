"""ILocalization2D: on the wire (`ILocalization2DMsgs.thrift`), its client, and its server for localizers.

with Localization2DClient("/localization2D_nws_yarp") as localizer:
    print(localizer.position)
    localizer.getCurrentPosition(location)     # as in C++: true if it succeeded

``ServiceServer(port, Localization2DServer(device))`` offers a localizer at a port. Meters and degrees.
"""

# mypy: disable-error-code="empty-body"
# ruff: noqa: D102 - the names are those of YARP's .thrift file

from __future__ import annotations

import math
from typing import Annotated, Any, Unpack

import numpy as np

from yarp_compat.dev import returnvalue
from yarp_compat.dev.basecontrol import OdometryData
from yarp_compat.dev.client import ClientOptions, ServiceClient
from yarp_compat.dev.fields import Nested, VocabEnum
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.map2d_client import succeeded
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnCode, ReturnValue, fetch, invoke, outcome_of
from yarp_compat.dev.server import DeviceCalls
from yarp_compat.dev.service import Service, rpc
from yarp_compat.overriding import override
from yarp_compat.sig.matrix import Matrix
from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.errors import WireError

SHAPE = (3, 3)


class CovarianceCodec(Nested):
    """A pose's 3x3 covariance; None is sent as zeros, because real clients hang on an empty matrix.

    Reading accepts an empty matrix, which servers of YARP 3.12 and 4.0 send on success (they confuse it with failure).
    """

    def __init__(self) -> None:
        super().__init__(Matrix)
        self.default = lambda: Matrix(*SHAPE)

    @override
    def write(self, out: ElementWriter, value: Any, *, tagged: bool = True) -> None:
        matrix = self.default() if value is None else value if isinstance(value, Matrix) else Matrix(np.asarray(value))
        if not matrix.numpy().size:
            matrix = self.default()
        _check_shape(matrix)
        super().write(out, matrix, tagged=tagged)

    @override
    def read(self, source: ElementReader) -> Matrix:
        matrix = Matrix()
        matrix._read(source)
        if matrix.numpy().size:
            _check_shape(matrix)
        return matrix


def _check_shape(matrix: Matrix) -> None:
    if matrix.numpy().shape != SHAPE:
        raise WireError(f"a pose's covariance must be 3x3, not {matrix.rows()}x{matrix.cols()}")


Covariance = Annotated[Matrix, CovarianceCodec()]


class LocalizationStatusEnum(VocabEnum):
    """The state of the localization."""

    localization_status_not_yet_localized = "locn"
    localization_status_localized_ok = "locy"
    localization_status_error = "err"


@rpc
class ILocalization2DMsgs(Service):
    """The methods of a localizer's port: meters, degrees; covariances of x, y, theta; estimated poses are particles."""

    def start_localization_service_RPC(self) -> ReturnValue: ...
    def stop_localization_service_RPC(self) -> ReturnValue: ...
    def get_localization_status_RPC(self) -> tuple[ReturnValue, LocalizationStatusEnum]: ...
    def get_estimated_poses_RPC(self) -> tuple[ReturnValue, list[Map2DLocation]]: ...
    def get_current_position1_RPC(self) -> tuple[ReturnValue, Map2DLocation]: ...
    def get_current_position2_RPC(self) -> tuple[ReturnValue, Map2DLocation, Covariance]: ...
    def get_estimated_odometry_RPC(self) -> tuple[ReturnValue, OdometryData]: ...
    def set_initial_pose1_RPC(self, loc: Map2DLocation) -> ReturnValue: ...
    def set_initial_pose2_RPC(self, loc: Map2DLocation, cov: Covariance) -> ReturnValue: ...


_UNSURE = LocalizationStatusEnum.localization_status_error
_FAILED = ReturnValue(ReturnCode.METHOD_FAILED)


class ILocalization2D:
    """The interface under YARP's names (`yarp/dev/ILocalization2D.h`); outcomes: `yarp_compat.dev.returnvalue`."""

    def __init__(self, localization: ILocalization2DMsgs) -> None:
        self._localization = localization

    startLocalizationService = outcome_of(ILocalization2DMsgs.start_localization_service_RPC, "_localization")
    stopLocalizationService = outcome_of(ILocalization2DMsgs.stop_localization_service_RPC, "_localization")

    def getLocalizationStatus(self, status: list[Any] | None = None) -> Any:
        """Return the state of the localization."""
        return fetch(self._localization.get_localization_status_RPC, into=status, default=_UNSURE)

    def getEstimatedPoses(self, poses: list[Map2DLocation] | None = None) -> Any:
        """Return the robot's possible poses: the particles. Servers of 3.12 and 4.0 never return any."""
        return fetch(self._localization.get_estimated_poses_RPC, into=poses, default=[])

    def getCurrentPosition(self, loc: Map2DLocation | None = None, cov: Matrix | None = None) -> Any:
        """Return the robot's pose, and also its covariance if a matrix is given for it.

        Servers of 3.12 and 4.0 confuse success and failure, and send neither pose nor covariance if they know both;
        this method reports that as a failure.
        """
        if cov is None:
            return fetch(self._localization.get_current_position1_RPC, into=loc, default=Map2DLocation())
        outcome, *results = returnvalue.results_of(self._localization.get_current_position2_RPC)
        if not outcome:
            return outcome
        location, covariance = results
        if not covariance.numpy().size:
            return _FAILED
        returnvalue.fill(Map2DLocation() if loc is None else loc, location)
        returnvalue.fill(cov, covariance)
        return outcome

    def getEstimatedOdometry(self, odom: OdometryData | None = None) -> Any:
        """Return the robot's odometry."""
        return fetch(self._localization.get_estimated_odometry_RPC, into=odom, default=OdometryData())

    def setInitialPose(self, loc: Map2DLocation, cov: Matrix | None = None) -> ReturnValue:
        """Set the robot's pose, and its covariance if given; fail if the covariance is not 3x3."""
        if cov is None:
            return invoke(self._localization.set_initial_pose1_RPC, loc)
        if cov.numpy().shape != (3, 3):
            return _FAILED
        return invoke(self._localization.set_initial_pose2_RPC, loc, cov)

    @property
    def position(self) -> Map2DLocation:
        """The robot's pose; raises `CallFailed` if it is unknown, `OSError` if the server does not reply."""
        outcome, location = self._localization.get_current_position1_RPC()
        succeeded(outcome)
        return location


class Localization2DClient(ServiceClient[ILocalization2DMsgs], ILocalization2D):
    """A client of a localization server; ``server`` and ``name`` are port prefixes; see `ServiceClient`."""

    def __init__(
        self, server: str = "/localization2D_nws_yarp", name: str = "", **options: Unpack[ClientOptions]
    ) -> None:
        rpc_port = name and f"{name}/localization/rpc"
        ServiceClient.__init__(self, ILocalization2DMsgs, f"{server}/rpc", rpc_port, **options)
        ILocalization2D.__init__(self, self.remote)


_STATUS = "localization_status_"
_NOT_KNOWN = "the robot's position is unknown"


class Localization2DServer(ILocalization2DMsgs):
    """Serves a localization device.

    Args:
        device: any object with the methods of YARP's ILocalization2D, or some of them; see `DeviceCalls`. They are
            called on the connections' threads, several at a time. ``getLocalizationStatus`` returns a status or its
            name (``localized_ok``); ``getCurrentPosition`` a location and its covariance (a 3x3 array or matrix, or
            None: zeros are sent); ``setInitialPose`` gets a location and a 3x3 array, or None if the client sent none.
    """

    def __init__(self, device: object) -> None:
        super().__init__()
        self._calls = DeviceCalls(device)

    @override
    def start_localization_service_RPC(self) -> ReturnValue:
        return self._calls.done("startLocalizationService")

    @override
    def stop_localization_service_RPC(self) -> ReturnValue:
        return self._calls.done("stopLocalizationService")

    @override
    def get_localization_status_RPC(self) -> tuple[ReturnValue, LocalizationStatusEnum]:
        status = self._calls.result("getLocalizationStatus", lacking="no status")
        if isinstance(status, str):
            status = LocalizationStatusEnum[_STATUS + status.removeprefix(_STATUS)]
        return OK, status

    @override
    def get_estimated_poses_RPC(self) -> tuple[ReturnValue, list[Map2DLocation]]:
        return OK, self._calls.result("getEstimatedPoses", lacking="no particles")

    @override
    def get_current_position1_RPC(self) -> tuple[ReturnValue, Map2DLocation]:
        return OK, self._position()[0]

    @override
    def get_current_position2_RPC(self) -> tuple[ReturnValue, Map2DLocation, Covariance]:
        return OK, *self._position()

    @override
    def get_estimated_odometry_RPC(self) -> tuple[ReturnValue, OdometryData]:
        return OK, self._calls.result("getEstimatedOdometry", lacking="no odometry")

    @override
    def set_initial_pose1_RPC(self, loc: Map2DLocation) -> ReturnValue:
        return self._set_pose(loc, None)

    @override
    def set_initial_pose2_RPC(self, loc: Map2DLocation, cov: Matrix) -> ReturnValue:
        return self._set_pose(loc, cov.numpy() if cov.numpy().size else None)

    def _position(self) -> tuple[Map2DLocation, Any]:
        location, covariance = self._calls.result("getCurrentPosition", lacking=_NOT_KNOWN)
        return location, covariance

    def _set_pose(self, loc: Map2DLocation, covariance: Any) -> ReturnValue:
        numbers = (loc.x, loc.y, loc.theta, *(() if covariance is None else covariance.ravel()))
        if not all(map(math.isfinite, numbers)):
            raise CallFailed(ReturnCode.METHOD_FAILED, "the pose or its covariance contains non-finite numbers")
        if covariance is not None and covariance.diagonal().min() < 0.0:
            raise CallFailed(ReturnCode.METHOD_FAILED, "the pose's covariance contains negative variances")
        return self._calls.done("setInitialPose", loc, covariance)
