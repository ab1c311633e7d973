"""The client devices of lasers, odometry, batteries and bases (`*_nwc_yarp`), with servers of several releases."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest

import yarp_compat as yarp
from tests.support.wait import until
from tests.yarp_compat.dev.drivers.conftest import Serve
from yarp_compat.dev.basecontrol import INavigation2DVelocityActionsMsgs, IOdometry2DMsgs, OdometryData
from yarp_compat.dev.battery import BatteryData, IBatteryMsgs
from yarp_compat.dev.rangefinder import DeviceStatus, LaserScan2D, Rangefinder2D
from yarp_compat.dev.returnvalue import OK, ReturnCode, ReturnValue
from yarp_compat.pythonic import Server, Writer
from yarp_compat.sig.vector import Vector
from yarp_compat.wire.generation import Generation
from yarp_compat.wire.values import Vocab

SCAN = LaserScan2D(0.0, 360.0, 0.1, 15.0, Vector([1.0, 2.0, 3.0, math.inf]), 1)
DRIVE = (0.5, 0.25, 10.0)


class Laser(Rangefinder2D):
    """A laser of YARP 3.10 and later."""

    def __init__(self) -> None:
        super().__init__()
        self.limits, self.rate = (0.0, 360.0), 10.0

    def getDistanceRange_RPC(self) -> tuple[ReturnValue, float, float]:
        return OK, 0.1, 15.0

    def getScanLimits_RPC(self) -> tuple[ReturnValue, float, float]:
        return OK, *self.limits

    def setScanLimits_RPC(self, min: float, max: float) -> ReturnValue:  # noqa: A002 - YARP's names
        self.limits = (min, max)
        return OK

    def getHorizontalResolution_RPC(self) -> tuple[ReturnValue, float]:
        return OK, 90.0

    def getScanRate_RPC(self) -> tuple[ReturnValue, float]:
        return OK, self.rate

    def setScanRate_RPC(self, rate: float) -> ReturnValue:
        self.rate = rate
        return OK

    def getDeviceInfo_RPC(self) -> tuple[ReturnValue, str]:
        return OK, "four rays"


class OldLaser:
    """Replies of a laser from before YARP 3.10, in vocabs (`IRangefinder2D.h`); all other requests fail.

    Among those is ``getRemoteProtocolVersion``, with which clients of YARP 4 begin.
    """

    def __init__(self) -> None:
        self.values: dict[str, tuple[float | str, ...]] = {
            "lsdr": (0.1, 15.0), "lsar": (0.0, 360.0), "lsas": (90.0,), "lssr": (10.0,), "lsnf": ("four rays",),
        }  # fmt: skip

    def __call__(self, words: list[Any]) -> list[Any]:
        match words:
            case ["get", "ilas", quantity] if quantity in self.values:
                return [Vocab("is"), Vocab(quantity), *self.values[quantity]]
            case ["set", "ilas", "lsar" | "lssr" as quantity, *values]:
                self.values[quantity] = tuple(values)
                return [Vocab("ok")]
        return [Vocab("fail")]


@pytest.fixture(params=["3.6", "3.12", "4.0"])
def laser(request: pytest.FixtureRequest, serve: Serve) -> Iterator[yarp.PolyDriver]:
    """Open a laser device connected to a server of a given YARP release."""
    generation = Generation.of(request.param)
    device = "rangefinder2D_nwc_yarp"
    with ExitStack() as old, Writer("/laser:o", profile=generation.profile) as stream:
        if generation is Generation.YARP_3_6:
            device = "Rangefinder2DClient"
            old.enter_context(Server("/laser:o/rpc:i", OldLaser()))
        else:
            serve("/laser:o/rpc:i", Laser(), generation)
        driver = yarp.PolyDriver(yarp.Property(f"(device {device}) (local /me) (remote /laser:o)"))
        assert driver.isValid()
        assert not driver.viewIRangefinder2D().getRawData(Vector()), "no scan has arrived"
        assert driver.viewIRangefinder2D().getDeviceStatus() is DeviceStatus.DEVICE_TIMEOUT
        stream.write(SCAN, "7 1795143618.5")
        until(lambda: driver.viewIRangefinder2D().newest(), "the scan has arrived")
        yield driver
        driver.close()


def test_a_laser_streams_scans_and_accepts_settings(laser: yarp.PolyDriver) -> None:
    view = laser.viewIRangefinder2D()
    distances, stamp = Vector(), yarp.DVector()
    assert view.getRawData(distances, stamp)
    assert (list(distances), stamp) == ([1.0, 2.0, 3.0, math.inf], [1795143618.5])
    distances[0] = 77.0
    points = list[Any]()
    assert view.getLaserMeasurement(points, stamp)
    assert [point.get_polar() for point in points[:2]] == [(1.0, 0.0), (2.0, math.pi / 2)]
    assert points[2].get_cartesian() == pytest.approx((-3.0, 0.0))
    assert view.getDeviceStatus() is view.DEVICE_OK_IN_USE
    assert view.getDistanceRange() == (OK, 0.1, 15.0)
    assert view.getScanLimits() == (OK, 0.0, 360.0)
    assert view.getHorizontalResolution() == 90.0
    assert view.getDeviceInfo() == "four rays"
    assert view.setScanLimits(10.0, 90.0)
    assert view.getScanLimits() == (OK, 10.0, 90.0)
    rate = yarp.DVector()
    assert view.setScanRate(20.0)
    assert view.getScanRate(rate)
    assert rate == [20.0]
    assert not view.setHorizontalResolution(1.0), "the laser does not implement it"
    assert not view.setDistanceRange(1.0, 2.0)


def test_a_laser_without_scan_limits_is_rejected(serve: Serve, caplog: pytest.LogCaptureFixture) -> None:
    serve("/laser:o/rpc:i", IOdometry2DMsgs())
    with Writer("/laser:o"), caplog.at_level(logging.ERROR):
        driver = yarp.PolyDriver(yarp.Property("(device rangefinder2D_nwc_yarp) (local /me) (remote /laser:o)"))
        assert not driver.isValid()
    assert "does not report its scan limits" in caplog.text
    assert not yarp.Network.exists("/me")


class Odometry(IOdometry2DMsgs):
    """An odometry source that counts its resets."""

    resets = 0

    def reset_odometry_RPC(self) -> ReturnValue:
        self.resets += 1
        return OK


def test_odometry_is_received_and_reset(serve: Serve) -> None:
    base = Odometry()
    serve("/base/rpc", base)
    with Writer("/base/odometry:o") as stream:
        driver = yarp.PolyDriver(yarp.Property("(device odometry2D_nwc_yarp) (local /me) (remote /base)"))
        view = driver.viewIOdometry2D()
        odometry, stamp = OdometryData(), yarp.DVector()
        assert not view.getOdometry(odometry, stamp)
        stream.write(OdometryData(odom_x=1.5), "3 12.25")
        until(lambda: view.getOdometry(odometry, stamp), "the odometry has arrived")
        assert (odometry.odom_x, stamp) == (1.5, [12.25])
        assert view.getOdometry() == (OK, odometry, 12.25)
        assert view.resetOdometry()
        assert base.resets == 1
        driver.close()


def test_odometry_is_received_again_after_its_server_has_restarted(serve: Serve) -> None:
    serve("/base/rpc", Odometry())
    with Writer("/base/odometry:o"):
        driver = yarp.PolyDriver(yarp.Property("(device odometry2D_nwc_yarp) (local /me) (remote /base)"))
    view = driver.viewIOdometry2D()
    with Writer("/base/odometry:o") as stream:
        until(lambda: stream.write(OdometryData(odom_x=2.5)) and view.getOdometry()[0], "the odometry arrives")
        assert view.getOdometry()[1] == OdometryData(odom_x=2.5)
    driver.close()


class Battery(IBatteryMsgs):
    """The RPC port of a battery of YARP 3.12 and later."""

    def getBatteryInfoRPC(self) -> tuple[ReturnValue, str]:
        return OK, "lead"


def old_battery(words: list[Any]) -> list[Any]:
    """Return the reply of a battery's RPC port before YARP 3.12 (`IBattery.h`)."""
    return [Vocab("is"), Vocab("btnf"), "lead"] if words == ["ibat", "btnf"] else [Vocab("fail")]


@pytest.mark.parametrize("device", ["battery_nwc_yarp", "batteryClient"])
@pytest.mark.parametrize("version", ["3.9", "3.12", "4.0"])
def test_batteries_of_all_releases_are_read(serve: Serve, version: str, device: str) -> None:
    generation = Generation.of(version)
    old = generation is Generation.YARP_3_6
    with ExitStack() as ports, Writer("/battery/data:o", profile=generation.profile) as stream:
        if old:
            ports.enter_context(Server("/battery/rpc:i", old_battery))
        else:
            serve("/battery/rpc:i", Battery(), generation)
        driver = yarp.PolyDriver(yarp.Property(f"(device {device}) (local /me) (remote /battery)"))
        view = driver.viewIBattery()
        assert view.getBatteryCharge() == 0.0
        assert view.getBatteryStatus() is yarp.IBattery.BATTERY_GENERAL_ERROR
        assert not view.getBatteryVoltage(yarp.DVector(1))
        # before 3.12 the order is voltage, current, charge
        stream.write([48.0, -2.5, 80.0, 31.0, 2] if old else BatteryData(80.0, 48.0, -2.5, 31.0, 2))
        until(lambda: view.newest(), "the state has arrived")
        assert (view.getBatteryVoltage(), view.getBatteryCurrent()) == (48.0, -2.5)
        assert (view.getBatteryCharge(), view.getBatteryTemperature()) == (80.0, 31.0)
        assert view.getBatteryStatus() is yarp.IBattery_BATTERY_OK_IN_USE
        voltage = yarp.DVector(1)
        assert view.getBatteryVoltage(voltage)
        assert voltage == [48.0]
        assert view.getBatteryInfo() == "lead"
        driver.close()
        assert not yarp.Network.exists("/me/data:i")


class Base(INavigation2DVelocityActionsMsgs):
    """A base that records its last command."""

    command: tuple[float, ...] = ()

    def applyVelocityCommandRPC(self, x_vel: float, y_vel: float, theta_vel: float, timeout: float) -> ReturnValue:
        self.command = (x_vel, y_vel, theta_vel, timeout)
        return OK

    def getLastVelocityCommandRPC(self) -> tuple[ReturnValue, float, float, float]:
        return (OK, *self.command[:3]) if self.command else (ReturnValue(ReturnCode.METHOD_FAILED), 0.0, 0.0, 0.0)


def test_a_base_is_driven(serve: Serve) -> None:
    base = Base()
    serve("/base/rpc:i", base)
    options = "(device mobileBaseVelocityControl_nwc_yarp) (local /me) (server /base)"
    driver = yarp.PolyDriver(yarp.Property(options))
    view = driver.viewINavigation2DVelocityActions()
    assert not view.getLastVelocityCommand()[0]
    assert view.applyVelocityCommand(*DRIVE)
    assert base.command == (*DRIVE, 0.1)
    assert view.getLastVelocityCommand() == (OK, *DRIVE)
    driver.close()
