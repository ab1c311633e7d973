"""The simulator's YARP ports, named like the robot's (``/cer/...``) or its Gazebo model's (``/SIM_CER_ROBOT/...``).

A laser (`rangefinder2D_nws_yarp`), odometry (`odometry2D_nws_yarp`), the battery (`battery_nws_yarp`, for each reader
in the field order of its YARP release), the depth camera's images (`rgbdSensor_nws_yarp`), and the wheels as a control
board (`controlBoard_nws_yarp`) for clients of YARP 3 and 4.
"""

from __future__ import annotations

import math

import numpy as np
from typing_extensions import override

from bridge.modules.host import Host
from sim.base import TICK_NS
from sim.board import WheelBoard
from sim.simulation import Simulation
from yarp_compat.dev.basecontrol import IOdometry2DMsgs, OdometryData
from yarp_compat.dev.battery import BatteryData, BatteryStatus, IBatteryMsgs, OlderBatteryVocabs
from yarp_compat.dev.controlboard.server import BoardHandler, positions
from yarp_compat.dev.rangefinder import DeviceStatus, LaserScan2D, Rangefinder2D, VocabReply
from yarp_compat.dev.returnvalue import OK, ReturnCode, ReturnValue
from yarp_compat.sig.image import ImageFloat
from yarp_compat.sig.vector import Vector

_ODOMETRY = 2
_BATTERY = 100  # ticks between two messages; _ODOMETRY is 50 Hz, _BATTERY 1 Hz
_IN_USE = BatteryStatus.BATTERY_OK_IN_USE
_TEMPERATURE = 30.0  # of the battery, degrees Celsius
_FIXED = ReturnValue(ReturnCode.NOT_IMPLEMENTED)


class RobotPorts:
    """The simulator's YARP ports.

    Args:
        prefix: prefix of the ports' names.
    """

    def __init__(self, host: Host, prefix: str, simulation: Simulation) -> None:
        self._simulation = simulation
        yarp = host.yarp
        self._laser = yarp.output(f"{prefix}/laser:o")
        yarp.serve(f"{prefix}/laser:o/rpc:i", _Laser(simulation))
        self._odometry = yarp.output(f"{prefix}/odometry:o")
        self._odometer = yarp.output(f"{prefix}/odometer:o")
        self._velocity = yarp.output(f"{prefix}/velocity:o")
        yarp.serve(f"{prefix}/rpc", _Reset(host, simulation))
        self._battery = yarp.output(f"{prefix}/battery:o")
        self._battery_data = yarp.output(f"{prefix}/battery/data:o", by_release=True)
        yarp.serve(f"{prefix}/battery/rpc:i", _Battery())
        self._board = _Board(host, f"{prefix}/{simulation.section.part}", simulation)
        # named like the port of rgbdSensor_nws_yarp
        camera = simulation.section.camera.rate
        self._depth = yarp.output(f"{prefix}/depthCamera/depthImage:o") if camera else None
        self._ticks = 0
        self._scanned = -1

    def publish(self, time_ns: int) -> None:
        """Write the messages that are due after a tick; ``time_ns`` is the time of their stamps."""
        self._ticks += 1
        envelope = f"{self._ticks} {time_ns / 1e9:.9f}"
        scan = self._simulation.scan
        if scan.time_ns != self._scanned:
            self._scanned = scan.time_ns
            if self._laser.has_readers:
                self._laser.write(self._scan(), envelope)
        if (
            self._depth is not None
            and self._simulation.pictured == self._simulation.time_ns
            and self._depth.has_readers
        ):
            self._depth.write(ImageFloat.of(self._simulation.depth()), envelope)
        if self._ticks % _ODOMETRY == 0 and "encoders_silent" not in self._simulation.faults:
            self._publish_odometry(envelope)
        if self._ticks % _ODOMETRY == 0:
            self._board.publish(envelope)
        if self._ticks % _BATTERY == 0:
            self._publish_battery(envelope)

    def _publish_battery(self, envelope: str) -> None:
        charge = self._simulation.battery.charge
        percent, current = 100.0 * charge.share, -charge.current
        data = BatteryData(percent, charge.voltage, current, _TEMPERATURE, int(_IN_USE))
        if self._battery.has_readers:
            self._battery.write(data.older(), envelope)
        if self._battery_data.has_readers:
            self._battery_data.write_by_release(
                lambda generation: data.older() if generation.before_3_12 else data, envelope
            )

    def _scan(self) -> LaserScan2D:
        """Return the last scan in YARP's order: counterclockwise from the robot's front, 0 to 360 degrees."""
        scan = self._simulation.scan
        front = round(-scan.first / scan.step)
        ranges = np.roll(scan.ranges, -front)
        return LaserScan2D(0.0, 360.0, scan.nearest, scan.farthest, Vector(ranges), int(DeviceStatus.DEVICE_OK_IN_USE))

    def _publish_odometry(self, envelope: str) -> None:
        estimate = self._simulation.estimate
        (x, y, yaw), (vx, vy, angular) = estimate.pose, estimate.twist
        c, s = math.cos(yaw), math.sin(yaw)
        degrees = math.degrees(angular)
        if self._odometry.has_readers:
            data = OdometryData(x, y, math.degrees(yaw), vx, vy, degrees, c * vx - s * vy, s * vx + c * vy, degrees)
            self._odometry.write(data, envelope)
        if self._odometer.has_readers:
            self._odometer.write([estimate.traveled, math.degrees(estimate.turned)], envelope)
        if self._velocity.has_readers:
            self._velocity.write([math.hypot(vx, vy), degrees], envelope)


class _Board:
    """The ports of the wheels' control board; their names begin with ``name``."""

    def __init__(self, host: Host, name: str, simulation: Simulation) -> None:
        # late=False, because a command whose call has timed out must not run later
        board = WheelBoard(lambda: simulation.wheels.board, lambda action: host.loop.call(action, late=False))
        handler = BoardHandler(board)
        self._board = board
        yarp = host.yarp
        yarp.serve(f"{name}/nws/rpc:i", handler.service)
        yarp.respond(f"{name}/rpc:i", handler.respond)
        yarp.input(f"{name}/command:i", handler.execute)
        host.answer("halt", lambda _params: host.loop.call(lambda: self._halt(simulation)))
        self._state, self._positions = yarp.output(f"{name}/stateExt:o"), yarp.output(f"{name}/state:o")

    @staticmethod
    def _halt(simulation: Simulation) -> dict[str, bool]:
        """Cancel the commands of the velocity drive and of the board; later commands are executed."""
        simulation.wheels.halt()
        return {"halted": True}

    def publish(self, envelope: str) -> None:
        """Write the state of the wheels; runs on the simulation's thread."""
        if self._state.has_readers or self._positions.has_readers:
            state = self._board.state()
            self._state.write(state, envelope)
            self._positions.write(positions(state), envelope)


class _Laser(Rangefinder2D):
    """The laser's settings, which come from the configuration; clients cannot change them."""

    def __init__(self, simulation: Simulation) -> None:
        super().__init__()
        self._simulation = simulation

    @override
    def getDeviceStatus_RPC(self) -> tuple[ReturnValue, DeviceStatus]:
        return OK, DeviceStatus.DEVICE_OK_IN_USE

    @override
    def getDistanceRange_RPC(self) -> tuple[ReturnValue, float, float]:
        section = self._simulation.section.laser
        return OK, section.nearest, section.farthest

    @override
    def setDistanceRange_RPC(self, min: float, max: float) -> ReturnValue:
        return _FIXED

    @override
    def getScanLimits_RPC(self) -> tuple[ReturnValue, float, float]:
        return OK, 0.0, 360.0

    @override
    def setScanLimits_RPC(self, min: float, max: float) -> ReturnValue:
        return _FIXED

    @override
    def getHorizontalResolution_RPC(self) -> tuple[ReturnValue, float]:
        return OK, 360.0 / self._simulation.section.laser.beams

    @override
    def setHorizontalResolution_RPC(self, step: float) -> ReturnValue:
        return _FIXED

    @override
    def getScanRate_RPC(self) -> tuple[ReturnValue, float]:
        """Return the scans per second; a scan takes whole ticks."""
        turn = round(1e9 / self._simulation.section.laser.rate / TICK_NS) * TICK_NS or TICK_NS
        return OK, 1e9 / turn

    @override
    def setScanRate_RPC(self, rate: float) -> ReturnValue:
        return _FIXED

    @override
    def getDeviceInfo_RPC(self) -> tuple[ReturnValue, str]:
        section = self._simulation.section.laser
        return OK, f"Midspan's simulated laser ({section.kind}, {section.beams} beams)"


class _Battery(IBatteryMsgs, OlderBatteryVocabs):
    """Describes the battery to clients of all releases."""

    _INFO = "Midspan's simulated battery"

    @override
    def getBatteryInfoRPC(self) -> tuple[ReturnValue, str]:
        """Answer clients of YARP 3.12 and later."""
        return OK, self._INFO

    @override
    def ibat_btnf(self) -> VocabReply:
        """Answer clients of YARP before 3.12."""
        return VocabReply("btnf", self._INFO)


class _Reset(IOdometry2DMsgs):
    def __init__(self, host: Host, simulation: Simulation) -> None:
        super().__init__()
        self._host, self._simulation = host, simulation

    @override
    def reset_odometry_RPC(self) -> ReturnValue:
        self._host.loop.call(self._simulation.sensing.odometry.reset)
        return OK
