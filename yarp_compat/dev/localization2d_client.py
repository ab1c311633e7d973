"""``ILocalization2D`` as YARP users know it, and the Python way.

with Localization2DClient("/localization2D_nws_yarp") as where:
    print(where.position)
    where.getCurrentPosition(location)         # as in C++: true where it succeeded
"""

from __future__ import annotations

from typing import Any

from yarp_compat.dev.client import PATIENCE, ServiceClient
from yarp_compat.dev.ilocalization2d import ILocalization2DMsgs, LocalizationStatusEnum
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.map2d_views import succeeded
from yarp_compat.dev.odometry import OdometryData
from yarp_compat.dev.outcome import answered, asked, called, fill
from yarp_compat.dev.returnvalue import ReturnCode, ReturnValue
from yarp_compat.naming.naming import Naming
from yarp_compat.sig.matrix import Matrix

_UNSURE = LocalizationStatusEnum.localization_status_error
_FAILED = ReturnValue(ReturnCode.METHOD_FAILED)


class ILocalization2D:
    """The interface under YARP's names (`yarp/dev/ILocalization2D.h`); what is filled in: `yarp_compat.dev.outcome`.

    Args:
        localization: the server.
    """

    def __init__(self, localization: ILocalization2DMsgs) -> None:
        self._localization = localization

    def startLocalizationService(self) -> ReturnValue:
        """Begin to localise."""
        return called(self._localization.start_localization_service_RPC)

    def stopLocalizationService(self) -> ReturnValue:
        """Rest."""
        return called(self._localization.stop_localization_service_RPC)

    def getLocalizationStatus(self, status: list[Any] | None = None) -> Any:
        """Whether the robot knows where it is."""
        return asked(self._localization.get_localization_status_RPC, into=status, default=_UNSURE)

    def getEstimatedPoses(self, poses: list[Map2DLocation] | None = None) -> Any:
        """Where the robot may be: the particles. Servers of 3.12 and 4.0 give none, ever."""
        return asked(self._localization.get_estimated_poses_RPC, into=poses, default=[])

    def getCurrentPosition(self, loc: Map2DLocation | None = None, cov: Matrix | None = None) -> Any:
        """Where the robot is; with its covariance where a matrix is given for that.

        Servers of 3.12 and 4.0 confuse success and failure, and send neither where they know both: a failure here.
        """
        if cov is None:
            return asked(self._localization.get_current_position1_RPC, into=loc, default=Map2DLocation())
        outcome, *found = answered(self._localization.get_current_position2_RPC)
        if not outcome:
            return outcome
        location, covariance = found
        if not covariance.numpy().size:
            return _FAILED
        fill(Map2DLocation() if loc is None else loc, location)
        fill(cov, covariance)
        return outcome

    def getEstimatedOdometry(self, odom: OdometryData | None = None) -> Any:
        """How far the robot has come and how fast it is."""
        return asked(self._localization.get_estimated_odometry_RPC, into=odom, default=OdometryData())

    def setInitialPose(self, loc: Map2DLocation, cov: Matrix | None = None) -> ReturnValue:
        """Tell where the robot is, and how sure that is: a covariance of 3x3."""
        if cov is None:
            return called(self._localization.set_initial_pose1_RPC, loc)
        if cov.numpy().shape != (3, 3):
            return _FAILED
        return called(self._localization.set_initial_pose2_RPC, loc, cov)

    @property
    def position(self) -> Map2DLocation:
        """Where the robot is.

        Raises:
            CallFailed: the server does not know.
            OSError: it is not there, or does not answer.
        """
        outcome, location = self._localization.get_current_position1_RPC()
        succeeded(outcome)
        return location


class Localization2DClient(ServiceClient[ILocalization2DMsgs], ILocalization2D):
    """A client of a localisation server, between ``with`` and its end.

    Args:
        server: what its ports begin with.
        name: what the own port begins with; empty lets the name server choose one.
        timeout: seconds to wait for a reply; None: for ever.
        naming: who knows the names; by default the name server of ``yarp.conf``.
    """

    def __init__(
        self,
        server: str = "/localization2D_nws_yarp",
        name: str = "",
        *,
        timeout: float | None = PATIENCE,
        naming: Naming | None = None,
    ) -> None:
        mine = name and f"{name}/localization/rpc"
        ServiceClient.__init__(self, ILocalization2DMsgs, f"{server}/rpc", mine, timeout=timeout, naming=naming)
        ILocalization2D.__init__(self, self.remote)
