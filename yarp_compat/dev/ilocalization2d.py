"""ILocalization2D on the wire: where a robot is on a map (`ILocalization2DMsgs.thrift`, `ILocalization2D.h`)."""

# mypy: disable-error-code="empty-body"

from __future__ import annotations

from enum import Enum
from typing import Annotated

from yarp_compat.dev.covariance import COVARIANCE
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.odometry import OdometryData
from yarp_compat.dev.returnvalue import ReturnValue
from yarp_compat.dev.service import Service, rpc
from yarp_compat.sig.matrix import Matrix

Covariance = Annotated[Matrix, COVARIANCE]


class LocalizationStatusEnum(Enum):
    """Whether a robot knows where it is."""

    localization_status_not_yet_localized = "locn"
    localization_status_localized_ok = "locy"
    localization_status_error = "err"


class ILocalization2DMsgs(Service):
    """What a localisation server's port answers; methods as YARP's service has them. Metres and degrees."""

    @rpc
    def start_localization_service_RPC(self) -> ReturnValue:
        """Begin to localise."""

    @rpc
    def stop_localization_service_RPC(self) -> ReturnValue:
        """Rest."""

    @rpc
    def get_localization_status_RPC(self) -> tuple[ReturnValue, LocalizationStatusEnum]:
        """Whether the robot knows where it is."""

    @rpc
    def get_estimated_poses_RPC(self) -> tuple[ReturnValue, list[Map2DLocation]]:
        """Where it may be: the particles."""

    @rpc
    def get_current_position1_RPC(self) -> tuple[ReturnValue, Map2DLocation]:
        """Where it is."""

    @rpc
    def get_current_position2_RPC(self) -> tuple[ReturnValue, Map2DLocation, Covariance]:
        """Where it is, and the covariance of x, y and theta."""

    @rpc
    def get_estimated_odometry_RPC(self) -> tuple[ReturnValue, OdometryData]:
        """How far it has come and how fast it is."""

    @rpc
    def set_initial_pose1_RPC(self, loc: Map2DLocation) -> ReturnValue:
        """Tell where it is."""

    @rpc
    def set_initial_pose2_RPC(self, loc: Map2DLocation, cov: Covariance) -> ReturnValue:
        """Tell where it is, and the covariance of x, y and theta."""
