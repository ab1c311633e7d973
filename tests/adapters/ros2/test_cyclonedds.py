"""A worker whose own participant is on Cyclone DDS; with rmw_cyclonedds_cpp, the contract suite has more tests."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from xml.etree import ElementTree as ET

import pytest

from bridge.adapters.ros2.cyclonedds import settings
from bridge.adapters.ros2.environment import worker_environment
from bridge.config.model import Config
from tests.adapters.ros2.conftest import RunningEdge
from tests.peers.ros2.network import has_rmw_cyclonedds, ros2_domain


def interfaces(text: str) -> dict[str, str | None]:
    """Return whether multicast is used, by interface."""
    used = ET.fromstring(text).iter("NetworkInterface")
    return {str(entry.get("name") or entry.get("address")): entry.get("multicast") for entry in used}


def addresses(text: str) -> list[str | None]:
    return [entry.get("Address") for entry in ET.fromstring(text).iter("Peer")]


def test_on_this_machine_only_loopback_has_multicast() -> None:
    text = settings(localhost_only=True, interfaces=["eth0", "wlan0"])
    assert interfaces(text) == {"127.0.0.1": "true", "eth0": "false", "wlan0": "false"}
    assert addresses(text) == ["127.0.0.1"]


def test_other_machines_are_found_on_all_interfaces_and_by_address() -> None:
    text = settings(localhost_only=False, interfaces=["eth0"], peers=["10.0.0.7"])
    assert interfaces(text) == {"127.0.0.1": "true", "eth0": "default"}
    assert addresses(text) == ["127.0.0.1", "10.0.0.7"]


def test_a_users_own_settings_choose_the_interfaces() -> None:
    assert interfaces(settings(localhost_only=False, interfaces=[])) == {}


@pytest.mark.skipif(not has_rmw_cyclonedds(), reason="rmw_cyclonedds_cpp is not installed (docs/sides/ros2.md)")
def test_a_midspan_on_cyclone_dds_recognizes_one_on_fast_dds(edge: RunningEdge) -> None:
    config = Config.model_validate({"ros2": {"domain": ros2_domain(), "rmw": "rmw_cyclonedds_cpp"}})
    done = subprocess.run(
        [sys.executable, "-m", "bridge.adapters.ros2.graph.reading"],
        input=config.model_dump_json(by_alias=True),
        env=worker_environment(config, os.environ),
        capture_output=True,
        encoding="utf-8",
        timeout=60,
        check=True,
    )
    assert json.loads(done.stdout.splitlines()[-1])["midspans"] == [edge.edge.network()]
