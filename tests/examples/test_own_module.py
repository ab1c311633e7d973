"""The skeleton of a module of one's own, as its part of the configuration has it run."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from tests.examples.deployment import EXAMPLES
from tests.modules.place import Place
from tests.support.wait import until
from yarp_compat.naming import connections
from yarp_compat.naming.server import NameServer
from yarp_compat.pythonic import Client

NAMED, BATTERY = "midspan_msgs/Named", "sensor_msgs/BatteryState"


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Place]:
    monkeypatch.syspath_prepend(str(EXAMPLES / "own_module"))
    with Place(tmp_path) as made:
        names = NameServer(port=made.port, gc_seconds=0)
        names.open()
        yield made
        made.worker.stop()
        names.close()
    sys.modules.pop("charge", None)


def test_a_robot_goes_to_its_charger(place: Place) -> None:
    own = yaml.safe_load((EXAMPLES / "own_module" / "midspan.yaml").read_text())["modules"]["own"]
    planner = place.far.serve("/navigation/go_to", NAMED, reply={"success": True})
    battery = place.far.advertise("/battery_state", BATTERY)
    place.worker.start(place.config(*own))

    def says(share: float, text: str) -> None:
        def once() -> bool:
            place.far.publish(battery, {"percentage": share})
            return text in str((place.status("charge") or {}).get("text"))

        until(once, f"it says {text}", 20, 0.1)

    says(0.5, "50% left")
    until(lambda: connections.exists(place.names, "/charge/rpc"), "its port is registered", 20)
    with Client("/charge/rpc", naming=place.names) as person:
        assert person.ask(["off"]) == ["ok"]
        says(0.1, "10% left; it is off")
        assert planner.requests(0) == []
        assert person.ask(["on"]) == ["ok"]
        assert person.ask(["nonsense"])[0] == "fail"
    says(0.15, "to charger")
    assert planner.requests(1)[0]["name"] == "charger"
    says(0.9, "90% left")
    says(0.1, "to charger")
    assert len(planner.requests(2)) == 2
