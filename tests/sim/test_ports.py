"""The simulator on YARP: laser, odometry, depth and battery, for clients of older and newer releases."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

import yarp_compat as yarp
from tests.peers.yarp.network import network_of
from tests.sim.test_hub import Place
from tests.support.wait import until
from yarp_compat.dev.basecontrol import IOdometry2DMsgs, OdometryData
from yarp_compat.dev.client import ServiceClient
from yarp_compat.dev.rangefinder import DeviceStatus, IRangefinder2DMsgs, LaserScan2D
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.naming.server import NameServer
from yarp_compat.pythonic import Client, Reader, Received
from yarp_compat.wire.values import Vocab


def test_yarp_clients_receive_laser_odometry_depth_and_battery(tmp_path: Path) -> None:
    with Place(tmp_path) as place, NameServer(port=place.port, gc_seconds=0):
        names = NameClient(Address("127.0.0.1", place.port), namespace="/root")
        laser = {"beams": 8, "farthest": 15.0}
        camera = {"rate": 5.0, "width": 24, "height": 16, "noise": 0.0, "pitch": 0.0}
        place.worker.start(place.config(plan="hall", start=(0.5, 0.0, 0.0), yarp="/cer", laser=laser, camera=camera))
        until(lambda: connections.exists(names, "/cer/battery/rpc:i"), "the last port is registered")
        until(lambda: "waiting" not in str(place.answer("sim")["ports"]), "all ports are open")
        check_streams(place, names)
        check_settings(names)
        check_batteries(names)
        with network_of(names):
            check_devices()
        place.worker.stop()


def check_streams(place: Place, names: NameClient) -> None:
    """Check the messages of all output ports."""

    def receive(port: str) -> Received:
        with Reader(f"/test{port}", naming=names) as reader:
            connections.connect(names, port, f"/test{port}")
            received = until(reader.read_now, f"a message from {port} has arrived")
        assert received is not None
        return received

    scan = receive("/cer/laser:o").to(LaserScan2D)
    assert (scan.angle_min, scan.angle_max, scan.range_max, scan.status) == (0.0, 360.0, 15.0, 1)
    # Ranges ahead, left, behind and right. The robot settles on its casters and moves by 2 mm.
    assert all(
        abs(r - wanted) < 0.05 for r, wanted in zip(list(scan.scans)[::2], (9.45, 6.95, 10.45, 6.95), strict=True)
    )
    depth = receive("/cer/depthCamera/depthImage:o").to(yarp.ImageFloat)
    assert (depth.width(), depth.height()) == (24, 16)
    assert depth.numpy()[7, 12] == pytest.approx(9.45 - 0.1, abs=0.05)  # from the camera to the wall ahead
    received = receive("/cer/odometry:o")
    odometry = received.to(OdometryData)
    assert abs(odometry.odom_x) < 0.01
    assert float(received.envelope.split()[1]) > 1.7e9
    assert len(receive("/cer/odometer:o").values) == 2
    assert len(receive("/cer/velocity:o").values) == 2
    voltage, current, charge, _, status = receive("/cer/battery:o").values
    assert 50 < voltage < 55
    assert current > 0
    assert 99 < charge <= 100
    assert status == 2
    charge, voltage, current, _, status = receive("/cer/battery/data:o").values
    assert (99 < charge <= 100, 50 < voltage < 55, current > 0, status == 2) == (True, True, True, True)


def check_batteries(names: NameClient) -> None:
    """Check that an older and a newer client, connected at once, each get the values in their release's order."""
    older, newer = Reader("/older/data:i", naming=names), Reader("/newer/data:i", naming=names)
    with older, newer, Client("/cer/battery/rpc:i", "/older/rpc:o", naming=names) as description:
        assert description.ask([Vocab("ibat"), Vocab("btnf")], timeout=20)[2] == "Midspan's simulated battery"
        for reader in ("/older/data:i", "/newer/data:i"):
            connections.connect(names, "/cer/battery/data:o", reader)
        voltage, _, charge, *_ = until(older.read_now, "an older client has the battery's state").values
        assert (50 < voltage < 55, 99 < charge <= 100) == (True, True)
        charge, voltage, *_ = until(newer.read_now, "a newer client has the battery's state").values
        assert (50 < voltage < 55, 99 < charge <= 100) == (True, True)


def check_devices() -> None:
    """Check the values that a script's devices return."""
    names = {
        "laser": "(device rangefinder2D_nwc_yarp) (remote /cer/laser:o)",
        "older": "(device Rangefinder2DClient) (remote /cer/laser:o)",
        "odometry": "(device odometry2D_nwc_yarp) (remote /cer)",
        "battery": "(device battery_nwc_yarp) (remote /cer/battery)",
    }
    drivers = {name: yarp.PolyDriver(yarp.Property(f"{text} (local /script/{name})")) for name, text in names.items()}
    assert all(driver.isValid() for driver in drivers.values())
    for laser in (drivers["laser"].viewIRangefinder2D(), drivers["older"].viewIRangefinder2D()):
        distances, points = yarp.Vector(), list[yarp.LaserMeasurementData]()
        until(lambda seen=laser, into=distances: seen.getRawData(into), "a scan has arrived")
        assert laser.getLaserMeasurement(points)
        assert points[2].get_cartesian() == pytest.approx((0.0, distances[2]), abs=0.01)
        assert laser.getDistanceRange()[1:] == (0.1, 15.0)
        assert laser.getDeviceStatus() is DeviceStatus.DEVICE_OK_IN_USE
    base, odometry, stamp = drivers["odometry"].viewIOdometry2D(), OdometryData(), yarp.DVector()
    until(lambda: base.getOdometry(odometry, stamp), "the odometry has arrived")
    assert abs(odometry.odom_x) < 0.01
    assert stamp[0] > 1.7e9
    assert base.resetOdometry()
    battery = drivers["battery"].viewIBattery()
    until(battery.getBatteryCharge, "the battery's state has arrived")
    assert 99 < battery.getBatteryCharge() <= 100
    assert 50 < battery.getBatteryVoltage() < 55
    assert battery.getBatteryStatus() is yarp.IBattery.BATTERY_OK_IN_USE
    assert "Midspan" in battery.getBatteryInfo()


def check_settings(names: NameClient) -> None:
    """Check the replies of the RPC ports, in the newer and older protocol."""
    with ServiceClient(IRangefinder2DMsgs, "/cer/laser:o/rpc:i", naming=names) as laser:
        assert laser.remote.getDistanceRange_RPC()[1:] == (0.1, 15.0)
        assert laser.remote.getScanLimits_RPC()[1:] == (0.0, 360.0)
        assert laser.remote.getHorizontalResolution_RPC()[1] == 45.0
        assert math.isclose(laser.remote.getScanRate_RPC()[1], 10.0)
        assert laser.remote.getDeviceStatus_RPC()[1] is DeviceStatus.DEVICE_OK_IN_USE
        assert "8 beams" in laser.remote.getDeviceInfo_RPC()[1]
        assert not laser.remote.setScanRate_RPC(5.0)
    with Client("/cer/laser:o/rpc:i", naming=names) as old:
        for request, answer in (
            ([Vocab("get"), Vocab("ilas"), Vocab("lsdr")], ["is", "lsdr", 0.1, 15.0]),
            ([Vocab("get"), Vocab("ilas"), Vocab("lsar")], ["is", "lsar", 0.0, 360.0]),
            ([Vocab("get"), Vocab("ilas"), Vocab("lsas")], ["is", "lsas", 45.0]),
            ([Vocab("set"), Vocab("ilas"), Vocab("lssr"), 5.0], ["fail"]),
            ([Vocab("get"), Vocab("ilas"), Vocab("what")], ["fail"]),
        ):
            reply = old.ask(request, timeout=20)
            assert reply == answer
    with ServiceClient(IOdometry2DMsgs, "/cer/rpc", naming=names) as odometry:
        assert odometry.remote.reset_odometry_RPC()
