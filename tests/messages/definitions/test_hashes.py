"""For every installed type, md5 sums equal those of genpy, and RIHS01 hashes equal those of rosidl."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import pytest

from bridge.messages.definitions.schema import World
from bridge.messages.definitions.sources import store_names
from bridge.messages.registry import Registry
from tests.messages.samples import GENPY, genpy_types
from tests.support.missing import ROS2, needs

SHARE = Path(sys.prefix) / "share"


@pytest.mark.skipif(not (GENPY / "genpy").is_dir(), reason="ROS 1 is not installed")
def test_md5_sums_are_those_of_genpy(registry: Registry):
    names = genpy_types()
    assert len(names) > 100
    for name in names:
        package, short = name.split("/")
        text = (GENPY / package / "msg" / f"_{short}.py").read_text(encoding="utf-8")
        announced = re.search(r'_md5sum = "(\w+)"', text)
        assert announced is not None
        assert registry.ros1(name).type_id == announced.group(1), name


@needs(ROS2)
def test_hashes_are_those_of_the_installed_packages(registry: Registry):
    checked = 0
    for path in SHARE.glob("*/*/*.json"):
        for entry in json.loads(path.read_text(encoding="utf-8")).get("type_hashes", []):
            name = entry["type_name"]
            assert registry.ros2(name).type_id == entry["hash_string"], name
            checked += 1
    assert checked > 500


@pytest.mark.parametrize("world", list(World))
def test_the_stores_agree_with_the_installed_packages(registry: Registry, world: World):
    """Definitions of rosbags replace those of missing packages, so both must be the same type."""
    bare = Registry(ros1_packages=Path("/nonexistent"))
    for name in store_names("sensor_msgs", world):
        if world is World.ROS1:
            assert bare.ros1(name).type_id == registry.ros1(name).type_id, name
        else:
            assert bare.ros2(name).type_id == registry.ros2(name).type_id, name


@pytest.mark.skipif(not (GENPY / "genpy").is_dir(), reason="ROS 1 is not installed")
def test_common_ros1_types_need_no_package():
    """The exception is roscpp's services that every node has, which are private to ROS 1."""
    bare, checked = Registry(ros1_packages=Path("/nonexistent")), 0
    for path in sorted(GENPY.glob("*/*/_*.py")):
        package, kind, stem = path.parts[-3], path.parts[-2], path.stem[1:]
        md5 = re.findall(r'^  _md5sum\s*=\s*["\'](\w+)["\']', path.read_text(encoding="utf-8"), re.MULTILINE)
        if kind not in ("msg", "srv") or not md5 or package == "roscpp":
            continue
        if kind == "msg":
            known = bare.ros1(f"{package}/{stem}").type_id
        else:
            known = bare.service_hub_to_ros1(f"{package}/srv/{stem}").side.type_id
        assert known == md5[-1], path
        checked += 1
    assert checked > 150


@pytest.mark.parametrize(
    ("name", "md5"),
    [
        ("actionlib/TestAction", "991e87a72802262dfbe5d1b3cf6efc9a"),
        ("shape_msgs/Mesh", "1ffdae9486cd3316a121c578b47a85cc"),
        ("stereo_msgs/DisparityImage", "04a177815f75271039fa21f16acad8c9"),
        ("trajectory_msgs/JointTrajectory", "65b4f94a94d1ed67169da35a02f33d3f"),
        ("visualization_msgs/Marker", "4048c9de2a16f4ae8e0538085ebf1b97"),
    ],
)
def test_common_types_that_are_not_installed_have_noetics_md5_sums(name: str, md5: str):
    """The md5 sums are those that Noetic's packages announce."""
    assert Registry(ros1_packages=Path("/nonexistent")).ros1(name).type_id == md5


def test_octomap_from_a_folder_has_its_known_md5(registry: Registry):
    """The md5 sum is the one that octomap_msgs of Noetic announces (index.ros.org, octomap_msgs 0.3.5)."""
    conversion = registry.ros1_to_hub("octomap_msgs/Octomap")
    assert conversion.source.type_id == "9a45536b45c5e409cd49f04bb2d9999f"
    assert conversion.target.name == "octomap_msgs/msg/Octomap"
    assert conversion.target.type_id == registry.ros2("octomap_msgs/msg/Octomap").type_id


@pytest.mark.parametrize(
    ("name", "md5"),
    [
        ("octomap_msgs/Octomap", "9a45536b45c5e409cd49f04bb2d9999f"),
        ("octomap_msgs/OctomapWithPose", "20b380aca6a508a657e95526cddaf618"),
        ("grid_map_msgs/GridMap", "95681e052b1f73bf87b7eb984382b401"),
        ("grid_map_msgs/GridMapInfo", "43ee5430e1c253682111cb6bedac0ef9"),
    ],
)
def test_maps_in_three_dimensions_need_no_package(name: str, md5: str) -> None:
    """The md5 sums are those in packages that Noetic's tools generated (rosjs, rosserial, rossharp)."""
    conversion = Registry(ros1_packages=Path("/nonexistent")).ros1_to_hub(name)
    assert conversion.source.type_id == md5
    assert conversion.target.name == name.replace("/", "/msg/")


def test_get_octomap_needs_no_package() -> None:
    call = Registry(ros1_packages=Path("/nonexistent")).service_hub_to_ros1("octomap_msgs/srv/GetOctomap")
    assert call.side.type_id == "be9d2869d24fe40d6bc21ac21f6bb2c5"
