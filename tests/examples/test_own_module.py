"""The example module, run from the example's configuration."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from tests.peers.daemon.examples import EXAMPLES
from tests.peers.hub.modules import Place
from tests.support.wait import until
from yarp_compat.naming import connections
from yarp_compat.naming.server import NameServer
from yarp_compat.pythonic import Client

NAMED, BATTERY = "midspan_msgs/Named", "sensor_msgs/BatteryState"


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Place]:
    monkeypatch.syspath_prepend(str(EXAMPLES / "own_module"))
    with Place(tmp_path) as rig:
        names = NameServer(port=rig.port, gc_seconds=0)
        names.open()
        yield rig
        rig.worker.stop()
        names.close()
    sys.modules.pop("charge", None)


def test_the_module_sends_the_robot_to_its_charger_when_the_battery_is_low(place: Place) -> None:
    section = yaml.safe_load((EXAMPLES / "own_module" / "midspan.yaml").read_text())["modules"]["own"]
    planner = place.far.serve("/navigation/go_to", NAMED, reply={"success": True})
    battery = place.far.advertise("/battery_state", BATTERY)
    place.worker.start(place.config(*section))

    def reports(share: float, text: str) -> None:
        def published() -> bool:
            place.far.publish(battery, {"percentage": share})
            return text in str((place.status("charge") or {}).get("text"))

        until(published, f"the status contains {text}", 20, 0.1)

    reports(0.5, "50% left")
    until(lambda: connections.exists(place.names, "/charge/rpc"), "the module's port is registered", 20)
    with Client("/charge/rpc", naming=place.names) as client:
        assert client.ask(["off"]) == ["ok"]
        reports(0.1, "10% left; off")
        assert planner.requests(0) == []
        assert client.ask(["on"]) == ["ok"]
        assert client.ask(["nonsense"])[0] == "fail"
    reports(0.15, "to charger")
    assert planner.requests(1)[0]["name"] == "charger"
    reports(0.9, "90% left")
    reports(0.1, "to charger")
    assert len(planner.requests(2)) == 2
