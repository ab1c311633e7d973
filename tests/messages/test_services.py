"""Services: fingerprints as ROS has them, pairs, derived types, and what is told of them on the hub."""

from __future__ import annotations

import re

import pytest

from bridge.messages.registry import Registry
from tests.messages.samples import GENPY

KNOWN_MD5 = {  # seen on the wire of a running navigation stack
    "nav_msgs/GetMap": "6cdd0a18e0aff5b0a3ca2326a89b54ff",
    "nav_msgs/GetPlan": "421c8ea4d21c6c9db7054b4bbdf1e024",
    "nav_msgs/LoadMap": "22e647fdfbe3b23c8c9f419908afaebd",
    "nav_msgs/SetMap": "c36922319011e63ed7784112ad4fdd32",
    "std_srvs/Empty": "d41d8cd98f00b204e9800998ecf8427e",
}
SERVICES = sorted(f"{path.parts[-3]}/{path.stem[1:]}" for path in GENPY.glob("*/srv/_[A-Z]*.py"))
ros1 = pytest.mark.skipif(not (GENPY / "genpy").is_dir(), reason="ROS 1 is not installed")


@ros1
@pytest.mark.parametrize("name", SERVICES)
def test_md5_sums_are_those_of_rospy(name: str, registry: Registry):
    package, short = name.split("/")
    announced = re.findall(r"""_md5sum = ["'](\w+)["']""", (GENPY / package / "srv" / f"_{short}.py").read_text())[-1]
    conversion = registry.service_ros1_to_hub(name, announced)
    assert (conversion.side.name, conversion.side.type_id) == (name, announced)
    assert announced == KNOWN_MD5.get(name, announced)


@ros1
@pytest.mark.parametrize("name", SERVICES)
def test_pairs_hold_both_ways(name: str, registry: Registry):
    there = registry.service_ros1_to_hub(name)
    back = registry.service_hub_to_ros1(there.hub.name, there.hub.type_id)
    assert (back.side, back.hub) == (there.side, there.hub)
    assert registry.service_ros2(there.hub.name, there.hub.type_id) == there.hub
