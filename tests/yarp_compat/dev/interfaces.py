"""YARP's navigation and frame transform services as its .thrift files declare them, as far as transcripts go."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from yarp_compat.dev.frametransform import FrameTransform
from yarp_compat.dev.imap2d import IMap2DMsgs
from yarp_compat.dev.locations import Map2DLocation, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.odometry import OdometryData
from yarp_compat.dev.returnvalue import ReturnValue
from yarp_compat.dev.service import Service, rpc
from yarp_compat.dev.structure import Structure
from yarp_compat.sig.matrix import Matrix


class NavigationStatus(Enum):
    IDLE = "idle"
    PREPARING = "prep"
    MOVING = "movg"
    WAITING = "wait"
    REACHED = "rech"
    ABORTED = "abrt"
    FAILING = "fail"
    PAUSED = "paus"
    THINKING = "thnk"
    ERROR = "err"


class Extent(Enum):
    GLOBAL = "glob"
    LOCAL = "loca"


class LocalizationStatus(Enum):
    NOT_YET = "locn"
    OK = "locy"
    ERROR = "err"


class Navigation(Service):
    @rpc
    def get_navigation_status_RPC(self) -> tuple[ReturnValue, NavigationStatus]: ...
    @rpc
    def goto_target_by_absolute_location_RPC(self, loc: Map2DLocation) -> ReturnValue: ...
    @rpc
    def goto_target_by_absolute_location_and_set_name_RPC(self, loc: Map2DLocation, name: str) -> ReturnValue: ...
    @rpc
    def goto_target_by_relative_location1_RPC(self, x: float, y: float) -> ReturnValue: ...
    @rpc
    def goto_target_by_relative_location2_RPC(self, x: float, y: float, theta: float) -> ReturnValue: ...
    @rpc
    def get_name_of_current_target_RPC(self) -> tuple[ReturnValue, str]: ...
    @rpc
    def get_absolute_location_of_current_target_RPC(self) -> tuple[ReturnValue, Map2DLocation]: ...
    @rpc
    def get_relative_location_of_current_target_RPC(self) -> tuple[ReturnValue, float, float, float]: ...
    @rpc
    def suspend_navigation_RPC(self, time_s: float) -> ReturnValue: ...
    @rpc
    def resume_navigation_RPC(self) -> ReturnValue: ...
    @rpc
    def stop_navigation_RPC(self) -> ReturnValue: ...
    @rpc
    def recompute_current_navigation_path_RPC(self) -> ReturnValue: ...
    @rpc
    def get_all_navigation_waypoints_RPC(self, kind: Extent) -> tuple[ReturnValue, Map2DPath]: ...
    @rpc
    def get_current_nav_waypoint_RPC(self) -> tuple[ReturnValue, Map2DLocation]: ...
    @rpc
    def get_current_navigation_map_RPC(self, kind: Extent) -> tuple[ReturnValue, MapGrid2D]: ...
    @rpc
    def follow_path_RPC(self, path: Map2DPath) -> ReturnValue: ...
    @rpc
    def apply_velocity_command_RPC(self, x: float, y: float, theta: float, timeout: float) -> ReturnValue: ...
    @rpc
    def get_last_velocity_command_RPC(self) -> tuple[ReturnValue, float, float, float]: ...


class Localization(Service):
    @rpc
    def start_localization_service_RPC(self) -> ReturnValue: ...
    @rpc
    def get_localization_status_RPC(self) -> tuple[ReturnValue, LocalizationStatus]: ...
    @rpc
    def get_estimated_poses_RPC(self) -> tuple[ReturnValue, list[Map2DLocation]]: ...
    @rpc
    def get_current_position1_RPC(self) -> tuple[ReturnValue, Map2DLocation]: ...
    @rpc
    def get_estimated_odometry_RPC(self) -> tuple[ReturnValue, OdometryData]: ...
    @rpc
    def set_initial_pose1_RPC(self, loc: Map2DLocation) -> ReturnValue: ...
    @rpc
    def set_initial_pose2_RPC(self, loc: Map2DLocation, cov: Matrix) -> ReturnValue: ...


class Transforms(Service):
    @rpc
    def setTransformRPC(self, transform: FrameTransform) -> ReturnValue: ...


class All(Navigation, IMap2DMsgs, Localization, Transforms):
    """Every method, so that a transcript's requests need no sorting."""


@dataclass
class Tree(Structure):
    """What the frame transform server sends all the time."""

    retvalue: ReturnValue = field(default_factory=ReturnValue)
    transforms: list[FrameTransform] = field(default_factory=list)
