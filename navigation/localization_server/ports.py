"""The topics and YARP ports on which LocalizationServer publishes."""

from __future__ import annotations

import math
from collections.abc import Sequence

from bridge.hub.wire.qos import LATCHED, Qos
from bridge.modules.host import Host
from bridge.tf.stamped import TF, TF_TYPE, Stamped, write
from navigation.frames import RobotFrames
from navigation.localization_server import estimate as estimates
from navigation.localization_server.estimate import Floats, LocalizationStatus, PoseEstimate
from navigation.messages import STRING, pose_message
from navigation.pose import Pose
from navigation.yarp import location_of
from yarp_compat.dev.basecontrol import OdometryData
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.os.data.stamp import Stamp

POSE, STATUS = "/localization/pose", "/localization/status"
REASON, PARTICLES = "/localization/reason", "/localization/particles"
_NOWHERE = OdometryData(*[math.nan] * 9)


class PosePublisher:
    """Publishes the pose for all sides; the stamps on ``/tf`` are ``ahead`` seconds ahead. Not thread-safe."""

    def __init__(self, host: Host, frames: RobotFrames, ports: Sequence[str], *, tf: bool, ahead: float) -> None:
        self._clock, self._frames, self._ahead_ns = host.clock, frames, round(ahead * 1e9)
        node = host.node
        self._pose = node.publisher(POSE, estimates.POSE_COVARIANCE, Qos(depth=1))
        self._status = node.publisher(STATUS, STRING, LATCHED, priority="state")
        self._reason = node.publisher(REASON, STRING, LATCHED, priority="state")
        self._particles = node.publisher(PARTICLES, estimates.POSES, LATCHED)
        self._tf = node.publisher(TF, TF_TYPE, Qos(depth=100)) if tf else None
        self._streams = [host.yarp.output(f"{port}/streaming:o") for port in ports]
        self._odometries = [host.yarp.output(f"{port}/odometry:o") for port in ports]
        self._stamp = Stamp()
        self._last: tuple[LocalizationStatus, str] | None = None

    def publish(
        self, estimate: PoseEstimate, correction: Pose | None, odometry: OdometryData | None, map_name: str
    ) -> None:
        """Publish the robot's pose and velocity, and the odometry frame on the map if ``correction`` is given."""
        self._publish_status(estimate)
        now = self._clock.now_ns()
        seconds, nanoseconds = divmod(now, 1_000_000_000)
        pose = estimate.pose
        if pose is not None and estimate.status is not LocalizationStatus.ERROR:
            self._pose.publish({
                "header": {
                    "stamp": {"sec": seconds, "nanosec": nanoseconds},
                    "frame_id": self._frames.map_frame,
                },
                "pose": {"pose": pose_message(pose), "covariance": estimates.spatial(estimate.covariance)},
            })  # fmt: skip
        if self._tf is not None and correction is not None:
            turned = (0.0, 0.0, math.sin(correction.theta / 2.0), math.cos(correction.theta / 2.0))
            names = self._frames.map_frame, self._frames.odom_frame
            self._tf.publish_cdr(
                write([Stamped(*names, now + self._ahead_ns, (correction.x, correction.y, 0.0), turned)])
            )
        self._write(estimate, odometry, map_name, now)

    def _publish_status(self, estimate: PoseEstimate) -> None:
        current = estimate.status, estimate.reason
        if self._last is None or current[0] is not self._last[0]:
            self._status.publish({"data": estimate.status.value})
        if current != self._last:
            self._reason.publish({"data": estimate.reason})
        self._last = current

    def _write(self, estimate: PoseEstimate, odometry: OdometryData | None, map_name: str, now: int) -> None:
        """Write to YARP's streams: NaN without a reliable pose, as upstream does."""
        if not any(port.has_readers for port in (*self._streams, *self._odometries)):
            return
        sure = estimate.status is LocalizationStatus.OK and estimate.pose is not None
        self._stamp.update(now / 1e9)
        envelope = self._stamp.to_text()
        nowhere = Map2DLocation(map_name, math.nan, math.nan, math.nan)
        position = location_of(map_name, estimate.pose) if sure and estimate.pose is not None else nowhere
        for port in self._streams:
            port.write(position, envelope)
        for port in self._odometries:
            port.write(odometry if sure and odometry is not None else _NOWHERE, envelope)

    def publish_particles(self, cloud: Floats) -> None:
        """Publish the particles, possible poses of the robot."""
        self._particles.publish_cdr(estimates.particles_cdr(self._clock.stamp(), self._frames.map_frame, cloud))
