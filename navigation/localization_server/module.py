"""LocalizationServer: the robot's pose on the map, for YARP clients and for all sides.

It replaces YARP's ``localization2D_nws_yarp`` and the localizer that it attaches. The configuration selects the source
of the pose: Midspan's own localizer or another one.
"""

# ruff: noqa: N802, D102 - the names are YARP's; `yarp_compat.dev.localization2d` documents them

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from typing_extensions import override

from bridge.config.sections.section import Section
from bridge.hub.wire.qos import Qos
from bridge.modules.host import Host
from bridge.modules.module import Module, imported_class
from bridge.status import Part
from bridge.stores.entry import StoreError
from bridge.worker import Health
from navigation.frames import FramesError, RobotFrames
from navigation.localization_server import estimate as estimates
from navigation.localization_server.checked import CheckedSource
from navigation.localization_server.estimate import (
    Floats,
    LocalizationStatus,
    OdometryEstimator,
    PoseEstimate,
    plane_of,
    pose_of,
)
from navigation.localization_server.other_server import YarpLocalizerClient
from navigation.localization_server.own import OwnLocalizer
from navigation.localization_server.ports import PosePublisher
from navigation.localization_server.section import LocalizationServerSection
from navigation.localization_server.sources import (
    AmclSource,
    FrameSource,
    PortSource,
    PoseSource,
    Start,
    TopicSource,
)
from navigation.map_in_use import MapInUse
from navigation.maps.grid import same_walls
from navigation.pose import Pose, check_rotation
from navigation.yarp import Calls, location_of
from yarp_compat.dev.basecontrol import OdometryData
from yarp_compat.dev.localization2d import Localization2DServer
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.returnvalue import CallFailed, ReturnCode

_PAUSED = "localization is stopped; startLocalizationService starts it again"

_MOST_POSES = 500  # particles in a reply, because each is a whole location with its map's name


class LocalizationServer(Module):
    """Publishes the robot's pose on the map."""

    name = "localization_server"

    @override
    def start(self, host: Host, section: Section) -> None:
        assert isinstance(section, LocalizationServerSection)
        self._host, self._section = host, section
        self._frames = RobotFrames(host, section.map_frame, section.base_frame, section.odom_frame)
        self._grid: MapGrid2D | None = None
        self._start: tuple[str, Start] | None = None
        self._paused = False
        self._motion = OdometryEstimator()
        self.source = self._make_source()  # Midspan's own localizer, or the one that the section names
        self._checked = CheckedSource(self.source, section.source or "own", host.log)
        self._publisher = PosePublisher(
            host,
            self._frames,
            section.ports,
            tf=section.publish_tf and self.source.corrects,
            ahead=section.tf_tolerance,
        )
        self._follow_maps()
        if self.source.accepts_starts:
            host.node.subscription(section.initialpose, estimates.POSE_COVARIANCE, self._on_start, Qos(depth=1))
        server = Localization2DServer(LocalizationDevice(self, Calls(host.loop)))
        for port in section.ports:
            host.yarp.serve(f"{port}/rpc", server)
        self._update_estimate()
        host.on_jump(self._on_clock_jump)
        host.every(section.period, self._publish)
        host.every(section.particles_period, lambda: self._publisher.publish_particles(self.cloud()))

    @override
    def reload(self, section: Section) -> bool:
        """Switch to another source of maps, if nothing else has changed; the source of the pose gets the new map."""
        assert isinstance(section, LocalizationServerSection)
        if self._section.model_copy(update={"map": section.map}) != section or section.source == "server":
            return False
        self._maps.close()
        self._section = section
        self._follow_maps()
        return True

    def _follow_maps(self) -> None:
        self._maps = MapInUse(self._host, self._section.map, self._use)
        if self._maps.of_store:
            self._maps.update()

    def _make_source(self) -> PoseSource:
        arguments = self._host, self._section, self._frames
        match self._section.source or "own":
            case "amcl":
                return AmclSource(*arguments)
            case "tf":
                return FrameSource(*arguments)
            case "topic":
                return TopicSource(*arguments)
            case "port":
                return PortSource(*arguments)
            case "server":
                return YarpLocalizerClient(*arguments, lambda: self.map_name)
            case "own":
                return OwnLocalizer(*arguments, self._publish)
            case factory:
                source: PoseSource = imported_class("the source of poses", factory, PoseSource)(*arguments)
                return source

    # requests

    @property
    def map_name(self) -> str:
        """The name of the current map; "" for none."""
        return self._grid.name if self._grid is not None else ""

    def estimate(self) -> PoseEstimate:
        """Return the estimate of the robot's pose."""
        estimate = self._checked.estimate()
        if self._paused:
            return replace(estimate, status=LocalizationStatus.NOT_YET, reason=_PAUSED)
        return estimate

    def cloud(self) -> Floats:
        """Return the particles, (n, 3) in meters and radians."""
        return self._checked.cloud()

    def odometry(self) -> OdometryData | None:
        """Return the robot's pose on the map and its velocity, if known."""
        pose = self._checked.estimate().pose
        return None if pose is None else self._motion.data(pose)

    def begin(self, pose: Pose, covariance: Floats | None, map_name: str) -> None:
        """Start at a pose on a map ("" for the current one); raises `RuntimeError` with the reason on failure."""
        if map_name in ("", self.map_name):
            self._checked.initial(pose, covariance)
            return
        if not self._maps.of_store:
            raise RuntimeError(f"the current map is {self.map_name!r} from {self._section.map}, not {map_name!r}")
        self._start = map_name, Start(pose, covariance)
        try:
            self._host.store.use_map(map_name)
        except StoreError as err:
            self._start = None
            raise RuntimeError(str(err)) from None
        self._maps.update()
        if self.map_name != map_name:
            self._start = None
            raise RuntimeError(self._maps.trouble or f"the map {map_name!r} is not the current one")

    def pause(self, *, on: bool) -> None:
        self._paused = on
        self.source.pause(on=on)

    def _on_start(self, message: dict[str, Any]) -> None:
        """Handle an initial pose from the topic to which rviz publishes."""
        frame = message["header"]["frame_id"].lstrip("/")
        if frame not in ("", self._frames.map_frame):
            self._refuse_start(f"the initial pose is in the frame {frame!r}, not in {self._frames.map_frame!r}")
            return
        start = message["pose"]
        try:
            check_rotation(start["pose"]["orientation"], "the initial pose's")
            self._checked.initial(pose_of(start["pose"]), plane_of(start["covariance"]))
        except (RuntimeError, ValueError) as err:
            self._refuse_start(str(err))

    def _refuse_start(self, reason: str) -> None:
        self._host.log.warning("%s: ignored: %s", self._section.initialpose, reason)

    def _use(self, grid: MapGrid2D | None) -> None:
        if grid is None or (self._grid is not None and same_walls(grid, self._grid)):
            return  # the same map again: the estimate stays valid
        self._grid = grid
        start, self._start = self._start, None
        try:
            self._checked.use_map(grid, start[1] if start is not None and start[0] == grid.name else None)
        except RuntimeError:
            if self._checked.without_map:
                self._grid = None  # so that the same map is tried again
            raise

    # events

    @override
    def on_failure(self, error: BaseException) -> bool:
        """Report an unknown pose, which stops the robot: without the failed callback, the estimate may be stale."""
        self._checked.fail(error)
        return True

    def _publish(self) -> None:
        try:
            self._motion.add(self._frames.odometry())
        except FramesError:
            self._motion.clear()
        estimate = self._update_estimate()
        correction = None if self._paused else self._checked.correction()
        odometry = None if estimate.pose is None else self._motion.data(estimate.pose)
        self._publisher.publish(estimate, correction, odometry, self.map_name)

    def _update_estimate(self) -> PoseEstimate:
        """Return the estimate, and store it for the threads that report health, which must not query the source."""
        self._estimate, self._particles = self.estimate(), len(self.cloud())
        return self._estimate

    def _on_clock_jump(self) -> None:
        self._motion.clear()
        self.source.on_clock_jump()

    # state

    @override
    def health(self) -> Health:
        if self._grid is None and self._section.source in (None, "own"):
            return Health("waiting", self._maps.trouble)
        status, reason = self._estimate.status.value, self._estimate.reason
        return Health("running", f"{status}: {reason}" if reason else status)

    @override
    def status(self) -> Part:
        estimate = self._estimate
        return Part(
            source=self._section.source or "own",
            map=self.map_name,
            localization=estimate.status.value,
            reason=estimate.reason,
            quality=round(estimate.quality, 3),
            pose=None if estimate.pose is None else list(estimate.pose[:3]),
            particles=self._particles,
            trouble=self._maps.trouble,
            **self.source.status().document(),
        )

    @override
    def stop(self) -> None:
        """Publish that the pose is unknown, so that planners stop at once, and end all subscriptions."""
        self._publisher.publish(estimates.unknown("localization has ended"), None, None, self.map_name)
        self.source.close()
        self._maps.close()


class LocalizationDevice:
    """YARP's methods, called on connections' threads, executed on the module's. Covariances: m, rad, as in ROS."""

    def __init__(self, server: LocalizationServer, calls: Calls) -> None:
        self._server, self._call = server, calls.do

    def startLocalizationService(self) -> None:
        self._call(lambda: self._server.pause(on=False))

    def stopLocalizationService(self) -> None:
        self._call(lambda: self._server.pause(on=True))

    def getLocalizationStatus(self) -> str:
        return self._call(lambda: self._server.estimate().status.value)

    def getEstimatedPoses(self) -> list[Map2DLocation]:
        cloud, name = self._call(lambda: (self._server.cloud(), self._server.map_name))
        few = cloud[:: max(1, math.ceil(len(cloud) / _MOST_POSES))]
        return [Map2DLocation(name, x, y, math.degrees(theta)) for x, y, theta in few.tolist()]

    def getCurrentPosition(self) -> tuple[Map2DLocation, Floats]:
        estimate, name = self._call(lambda: (self._server.estimate(), self._server.map_name))
        if estimate.pose is None:
            raise CallFailed(ReturnCode.METHOD_FAILED, estimate.reason)
        return location_of(name, estimate.pose), estimate.covariance

    def getEstimatedOdometry(self) -> OdometryData:
        odometry = self._call(self._server.odometry)
        if odometry is None:
            raise CallFailed(ReturnCode.METHOD_FAILED, "the robot's pose is unknown")
        return odometry

    def setInitialPose(self, loc: Map2DLocation, cov: Floats | None) -> None:
        pose = Pose(loc.x, loc.y, math.radians(loc.theta))
        covariance = cov if cov is not None and cov.any() else None  # zeros would mean certainty
        try:
            self._call(lambda: self._server.begin(pose, covariance, loc.map_id))
        except RuntimeError as err:
            raise CallFailed(ReturnCode.METHOD_FAILED, str(err)) from None
