"""``/clock`` is YARP's network clock in both directions, and messages without a stamp get that clock's time."""

from __future__ import annotations

from pathlib import Path

import pytest

import yarp_compat as yarp
from tests.adapters.yarp.conftest import Place
from tests.support.wait import until

CLOCK = "rosgraph_msgs/Clock"


def test_yarp_program_uses_the_simulated_time(place: Place, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("YARP_CONFIG_HOME", str(tmp_path))
    monkeypatch.delenv("YARP_NAMESPACE", raising=False)
    monkeypatch.setenv("YARP_CLOCK", "/midspan/clock:o")
    (tmp_path / "yarp.conf").write_text(f"{place.names.address.host} {place.names.address.port} yarp\n")
    place.bridge()
    out = place.far.advertise("/clock", CLOCK)
    with yarp.Network():
        assert yarp.Time.isNetworkClock()
        time = {"clock": {"sec": 41, "nanosec": 250_000_000}}
        until(lambda: (place.far.publish(out, time), yarp.now())[1] == 41.25, "the program has the simulation's time")


def test_messages_without_a_stamp_get_the_time_of_a_yarp_simulator(place: Place) -> None:
    rules = [
        {"port": "/clock", "topic": "/clock", "type": "rosgraph_msgs/msg/Clock", "direction": "in"},
        {"topic": "/place", "type": "geometry_msgs/msg/TwistStamped", "as": "natural"},
    ]
    simulated = place.bridge(*rules, clock={"source": "sim"}).bridge._engine.edge.clock
    clock, robot = place.port("/clock"), place.port("/robot:o")
    times, velocities = (
        place.far.subscribe("/clock", CLOCK),
        place.far.subscribe("/place", "geometry_msgs/TwistStamped"),
    )
    until(lambda: (clock.write([1000, 5]), place.far.wait(times, 1, 0.2))[1], "the hub receives the time")
    assert place.far.wait(times, 1)[-1] == {"clock": {"sec": 1000, "nanosec": 5}}
    until(lambda: simulated.now_ns() == 1_000_000_000_005, "the bridge has the time, which it first publishes")
    robot.write_to("/midspan/place:i")
    until(lambda: (robot.write([0.5, 0.0, 10.0]), place.far.wait(velocities, 1, 0.2))[1], "a velocity is bridged")
    assert place.far.wait(velocities, 1)[-1]["header"]["stamp"] == {"sec": 1000, "nanosec": 5}
