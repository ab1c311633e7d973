"""Packages that are built, used as installed, or cannot be resolved."""

from __future__ import annotations

from pathlib import Path

import pytest

from bridge.interfaces.builder import BuildStep, PackageResolver
from bridge.interfaces.cache import BuildCache
from bridge.interfaces.definition import BuildError
from bridge.interfaces.folders import bundled_files
from bridge.interfaces.ros2 import Ros2

Packages = dict[str, dict[str, str]]


def steps(given: Packages) -> dict[str, BuildStep]:
    planner = PackageResolver(given, Ros2.find(), BuildCache(Path("/nowhere")))
    return {step.package: step for step in planner.steps()}


def test_needed_packages_come_first() -> None:
    planned = steps({"a_msgs": {"msg/A.msg": "b_msgs/B b\ntf2_msgs/TFMessage tf"}, "b_msgs": {"msg/B.msg": "int8 b"}})
    assert list(planned)[-1] == "a_msgs"
    assert set(planned) == {"a_msgs", "b_msgs", "tf2_msgs"}
    assert {step.package for step in planned["a_msgs"].needs} == {"b_msgs", "tf2_msgs"}


def test_installed_packages_are_not_built() -> None:
    assert steps({"std_msgs": {"msg/String.msg": "string data"}}) == {}


def test_an_installed_package_cannot_be_extended() -> None:
    with pytest.raises(BuildError, match=r"std_msgs .* has no msg/Mine\.msg"):
        steps({"std_msgs": {"msg/Mine.msg": "string data"}})


def test_a_part_of_a_built_in_package_is_built_as_the_whole_package() -> None:
    part = {"msg/ProjectedMapInfo.msg": bundled_files("map_msgs")["msg/ProjectedMapInfo.msg"]}
    assert steps({"map_msgs": part})["map_msgs"].prefix == steps({"map_msgs": {}})["map_msgs"].prefix


def test_additional_types_of_a_built_in_package_are_added() -> None:
    more = steps({"map_msgs": {"msg/Mine.msg": "ProjectedMapInfo info"}})["map_msgs"]
    assert {"msg/Mine.msg", "msg/ProjectedMap.msg"} <= {definition.path for definition in more.definitions}


KEYS: list[tuple[str, Packages]] = [
    ("another text", {"a_msgs": {"msg/A.msg": "b_msgs/B c"}, "b_msgs": {"msg/B.msg": "int8 b"}}),
    ("another text in what is needed", {"a_msgs": {"msg/A.msg": "b_msgs/B b"}, "b_msgs": {"msg/B.msg": "int16 b"}}),
]


@pytest.mark.parametrize("given", [given for _, given in KEYS], ids=[name for name, _ in KEYS])
def test_the_cache_key_covers_all_inputs_of_the_build(given: Packages) -> None:
    base: Packages = {"a_msgs": {"msg/A.msg": "b_msgs/B b"}, "b_msgs": {"msg/B.msg": "int8 b"}}
    assert steps(base)["a_msgs"].prefix == steps(dict(reversed(base.items())))["a_msgs"].prefix
    assert steps(base)["a_msgs"].prefix != steps(given)["a_msgs"].prefix


CIRCLE: Packages = {"a_msgs": {"msg/A.msg": "b_msgs/B b"}, "b_msgs": {"msg/B.msg": "a_msgs/A a"}}
FAULTS: list[tuple[str, Packages, str, str]] = [
    ("unknown package", {"a_msgs": {"msg/A.msg": "int8 a\nnone_msgs/B b"}}, "a_msgs/msg/A.msg:2", "none_msgs is not"),
    ("unknown type", {"a_msgs": {"msg/A.msg": "std_msgs/Strin b"}}, "a_msgs/msg/A.msg:1", "std_msgs/Strin"),
    ("unknown own type", {"a_msgs": {"msg/A.msg": "B b"}}, "a_msgs/msg/A.msg:1", "unknown type a_msgs/B"),
    ("bare Header", {"a_msgs": {"msg/A.msg": "Header h"}}, "a_msgs/msg/A.msg:1", "std_msgs/Header"),
    ("circle", CIRCLE, "", "a_msgs -> b_msgs -> a_msgs"),
]


@pytest.mark.parametrize(("given", "where", "word"), [f[1:] for f in FAULTS], ids=[f[0] for f in FAULTS])
def test_unresolved_references_are_reported_with_their_place(given: Packages, where: str, word: str) -> None:
    with pytest.raises(BuildError) as caught:
        steps(given)
    assert caught.value.where == where
    assert word in str(caught.value)
