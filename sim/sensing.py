"""The simulated robot's sensors, with the faults that a client has injected."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from bridge.messages.scan import LaserScan
from sim.base import TICK_NS, Base, Encoders
from sim.depth import DepthCamera, Depths
from sim.laser import Laser
from sim.robot import RobotDescription
from sim.section import SimSection
from sim.sensors import Faults, Odometry, WheelEncoders
from sim.world import FloorWorld


class Sensing:
    """Laser, depth camera, encoders and odometry.

    Attributes:
        faults: the injected faults.
        odometry: the odometry from the encoders.
        camera: the depth camera, if any.
        scan: the last scan.
        pictured: when the camera took its last picture, ns; -1 before the first.
    """

    def __init__(
        self, section: SimSection, robot: RobotDescription, base: Base, world: FloorWorld, time_ns: int
    ) -> None:
        encoder_noise, laser_noise = np.random.default_rng(section.seed).spawn(2)
        self.faults = Faults()
        self.odometry = Odometry(base)
        self.camera = DepthCamera(section.camera, section.seed) if section.camera.rate else None
        self.pictured = -1
        self._base, self._begun = base, time_ns
        self._encoders = WheelEncoders(base, section.encoders, encoder_noise)
        self._reading: Encoders | None = None
        self._laser = Laser(section.laser, robot.lasers, laser_noise)
        self._scan_ns, self._picture_ns = _period(section.laser.rate), _period(section.camera.rate or 1.0)
        self._depth: tuple[int, Depths] | None = None
        self.scan = self._scan(world, time_ns)

    def read(self, time_ns: int, *, rests: bool = False) -> Encoders:
        """Return an encoder reading, and update the odometry; ``rests``: nothing has moved since the last reading."""
        self._encoders.frozen = "encoders_frozen" in self.faults
        last, reading = self._reading, self._encoders.read(time_ns, rests=rests)
        if last is not None and reading.positions is last.positions and reading.velocities is last.velocities:
            self.odometry.repeat(time_ns)
        else:
            self.odometry.add(reading)
        self._reading = reading
        return reading

    def observe(self, world: FloorWorld, time_ns: int) -> None:
        """Scan if a scan is due, and record the time if a picture is due; `depth` computes the picture."""
        since = time_ns - self._begun
        if since % self._scan_ns == 0 and "laser_silent" not in self.faults:
            self.scan = self._scan(world, time_ns)
        if self.camera is not None and since % self._picture_ns == 0 and "camera_silent" not in self.faults:
            self.pictured = time_ns

    def depth(self, world: FloorWorld, time_ns: int) -> Depths:
        """Return the depth camera's current picture, (height, width) meters; the first call at a time computes it."""
        assert self.camera is not None
        if self._depth is None or self._depth[0] != time_ns:
            seen = self.camera.picture(time_ns, self._base.pose(), world.solids(), world.drops)
            if "camera_blind" in self.faults:
                seen[:] = math.nan
            self._depth = time_ns, seen
        return self._depth[1]

    def _scan(self, world: FloorWorld, time_ns: int) -> LaserScan:
        seen = self._laser.scan(time_ns, self._base.pose(), *world.seen())
        return replace(seen, ranges=np.full_like(seen.ranges, math.nan)) if "laser_blind" in self.faults else seen


def _period(rate: float) -> int:
    """Return the period of a rate (Hz) in whole ticks, ns."""
    return round(1e9 / rate / TICK_NS) * TICK_NS or TICK_NS
