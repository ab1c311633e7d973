"""`PolyDriver`: devices open and close, and failures are logged with their reason."""

from __future__ import annotations

import logging

import pytest

import yarp_compat as yarp
from tests.peers.yarp.map_server import KeptMaps
from tests.yarp_compat.dev.drivers.conftest import Serve
from yarp_compat.dev.drivers import registry

MAPS = "(device map2D_nwc_yarp) (local /mine) (remote /maps)"


@pytest.fixture
def maps(serve: Serve) -> KeptMaps:
    server = KeptMaps()
    serve("/maps/rpc", server)
    return server


def test_a_device_stays_open_until_closed(maps: KeptMaps) -> None:
    driver = yarp.PolyDriver()
    assert not driver.isValid()
    assert not driver.close(), "nothing was opened"
    assert driver.viewIMap2D() is None
    assert driver.open(yarp.Property(MAPS))
    assert driver.isValid()
    assert not driver.open(yarp.Property(MAPS)), "the device is already open"
    assert driver.isValid()
    assert driver.viewIMap2D().storeLocation("here", yarp.Map2DLocation("m1", 1.0, 2.0, 3.0))
    assert maps.kept["location"]["here"].x == 1.0
    assert driver.viewINavigation2D() is None, "a map server is not a planner"
    assert driver.viewIGazeControl() is None  # type: ignore[attr-defined] # all views of the bindings are there
    assert driver.close()
    assert not driver.isValid()
    assert not driver.close()
    assert not yarp.Network.exists("/mine/mapClient_rpc")


@pytest.mark.usefixtures("maps")
def test_a_device_closes_with_its_driver_and_with_the_network(caplog: pytest.LogCaptureFixture) -> None:
    driver = yarp.PolyDriver(yarp.Property(MAPS))
    assert driver.isValid()
    assert yarp.Network.exists("/mine/mapClient_rpc")
    view = driver.viewIMap2D()
    with caplog.at_level(logging.INFO):
        del driver
    assert "the device <map2D_nwc_yarp> is closed: its PolyDriver was garbage collected" in caplog.text
    assert not yarp.Network.exists("/mine/mapClient_rpc")
    assert not view.clearAllMaps(), "the view no longer works once the driver is closed"
    again = yarp.PolyDriver(yarp.Property(MAPS))
    yarp.Network.fini()
    yarp.Network.init()
    assert not again.isValid()
    assert not yarp.Network.exists("/mine/mapClient_rpc")


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ("(device map2D_nwc_yarp) (remote /maps)", "the option 'local' of map2D_nwc_yarp is missing"),
        ('(device map2D_nwc_yarp) (local "") (remote /maps)', "the option 'local' of map2D_nwc_yarp is empty"),
        ('(device map2D_nwc_yarp) (local "my name") (remote /maps)', "must be a port like /robot/battery"),
        ("(device map2D_nwc_yarp) (local /mine) (remote /missing)", "/missing/rpc"),
        ("(device map2D_nwc_yarp) (local /mine) (remote /maps) (carrier pigeon)", "pigeon"),
        ("(device grabber)", "read the camera's port with BufferedPortImageRgb"),
        ("(device fakeBattery)", "only serves YARP's own tests"),
        ("(device coffee_machine)", "unknown device 'coffee_machine'; supported are navigation2D_nwc_yarp"),
        ("(local /mine)", "unknown device '(local \"/mine\")'"),
    ],
)
@pytest.mark.usefixtures("maps")
def test_a_failed_open_logs_the_reason(caplog: pytest.LogCaptureFixture, options: str, reason: str) -> None:
    with caplog.at_level(logging.ERROR):
        driver = yarp.PolyDriver(yarp.Property(options))
    assert not driver.isValid()
    assert reason in caplog.text
    assert not yarp.Network.exists("/mine/mapClient_rpc"), "the ports opened before the failure are closed"
    assert driver.close(), "close succeeds after any call of open, as in YARP"
    assert not yarp.PolyDriver().open_str("map2D_nwc_yarp")


def test_a_device_needs_an_initialized_network(caplog: pytest.LogCaptureFixture) -> None:
    assert not yarp.PolyDriver(yarp.Property(MAPS)).isValid()
    assert "Network.init()" in caplog.text


WITHOUT = {"frameTransformClient", "frameTransform_nwc_yarp"}  # these need no option


@pytest.mark.parametrize("device", sorted({*registry.names()} - WITHOUT))
def test_every_device_requires_its_options(device: str) -> None:
    make = registry.factory(device)
    with pytest.raises(registry.DeviceError, match=f"of {device} is missing"):
        make(registry.DeviceOptions(device, yarp.Property()))


def test_options_are_converted_and_invalid_ones_rejected() -> None:
    options = registry.DeviceOptions("x", yarp.Property("(n 1.5) (i 3) (on true) (off 0) (word fast) (list (1 2))"))
    assert (options.number("n", 0.0), options.number("i", 0.0), options.number("none", 7.0)) == (1.5, 3.0, 7.0)
    assert (options.flag("on", default=False), options.flag("off", default=True)) == (True, False)
    assert options.flag("none", default=True)
    assert options.text("word") == "fast"
    assert options.text("none", "") == ""
    assert options.port("word") == "/fast", "YARP's port names start with a slash"
    for read in (options.number, lambda key, _: options.flag(key, default=False)):
        with pytest.raises(registry.DeviceError, match=r"the option 'word' of x must be .*, not fast"):
            read("word", 0.0)
