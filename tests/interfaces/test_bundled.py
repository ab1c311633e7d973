"""The definitions that come with Midspan have the hashes of the real packages."""

from __future__ import annotations

import importlib
import json
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bridge.interfaces import build_bundled, bundled_files, bundled_packages
from bridge.interfaces.cache import members

PUBLISHED = {
    # rmw_zenoh's design page and many logs of `ros2 topic info -v`
    "tf2_msgs/msg/TFMessage": "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    # a log of `ros2 topic info -v` on the costmap of Nav2, on Jazzy
    "map_msgs/msg/OccupancyGridUpdate": "RIHS01_c4095b0be2e4363f8978a1570e0293ee093436f1e1c61d99b48502ac317025e8",
    # tables of hashes in independent zenoh clients for ROS 2
    "nav2_msgs/action/NavigateToPose_FeedbackMessage": (
        "RIHS01_9d1f6fa2eb975ce733b419ac2e97b134d8ff92b6478b6559feed9a50bdfd82b3"
    ),
}


@pytest.fixture(scope="module")
def hashes() -> dict[str, str]:
    """Return the hash of every type in the built packages, as written by ROS 2's own generator."""
    hashes_by_name: dict[str, str] = {}
    for name, folder in members(build_bundled()).items():
        for file in (folder / "share" / name).glob("*/*.json"):
            entries = json.loads(file.read_text(encoding="utf-8"))["type_hashes"]
            hashes_by_name |= {entry["type_name"]: entry["hash_string"] for entry in entries}
    return hashes_by_name


def test_bundled_types_have_their_published_hashes(hashes: dict[str, str]) -> None:
    assert {name: hashes.get(name) for name in PUBLISHED} == PUBLISHED


def test_rosbags_computes_the_same_hashes(hashes: dict[str, str]) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    for package in bundled_packages():
        for path, text in bundled_files(package).items():
            if path.startswith("msg/"):
                store.register(get_types_from_msg(text, f"{package}/msg/{Path(path).stem}"))
    names = [name for name in hashes if name.split("/")[0] in bundled_packages() and name.split("/")[1] == "msg"]
    assert len(names) > 30
    assert {name: store.hash_rihs01(name) for name in names} == {name: hashes[name] for name in names}


def test_rosbags_own_definition_of_tf2_has_the_same_hash(hashes: dict[str, str]) -> None:
    name = "tf2_msgs/msg/TFMessage"
    assert get_typestore(Stores.ROS2_JAZZY).hash_rihs01(name) == hashes[name]


IMPORTED = [
    ("tf2_msgs.msg", "TFMessage"),
    ("map_msgs.msg", "OccupancyGridUpdate"),
    ("nav2_msgs.srv", "LoadMap_Request"),
    ("octomap_msgs.msg", "OctomapWithPose"),
    ("grid_map_msgs.msg", "GridMap"),
]


@pytest.mark.parametrize(("module", "name"), IMPORTED)
def test_the_packages_import_in_this_environment(module: str, name: str) -> None:
    kind = getattr(importlib.import_module(module), name)
    assert hasattr(kind, "get_fields_and_field_types"), f"{kind} is not ROS 2's"
