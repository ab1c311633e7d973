"""The contents of files that sections name are checked at load, so that a mistake stops nothing that runs."""

# ruff: noqa: E501  each case is one line

from __future__ import annotations

from pathlib import Path

import pytest

from bridge.config.document import ConfigError
from bridge.config.load import load, loads

GEOMETRY = "[ROBOT_GEOMETRY]\ngeom_r 0.1\ngeom_L 0.3\n"
BASE = "[BASECTRL_GENERAL]\nrobot_type cer\nmax_linear_vel 0.3\nmax_angular_vel 30\n" + GEOMETRY


def module(name: str, keys: str, *, enabled: str = "true") -> str:
    return f"modules: {{{name}: {{enabled: {enabled}, {keys}}}}}"


@pytest.mark.parametrize(
    ("name", "keys", "text", "problem"),
    [
        ("base_control", "", BASE.replace("geom_r 0.1", "geom_r wide"), "ini: PATH:6: 'geom_r' must be a number, not 'wide'"),
        ("base_control", "", BASE.replace("geom_L 0.3\n", ""), "ini: PATH:5: 'geom_L' is missing in [ROBOT_GEOMETRY]"),
        ("base_control", "", BASE.replace(GEOMETRY, ""), "ini: PATH: the group [ROBOT_GEOMETRY] is missing"),
        ("base_control", "", BASE.replace("cer", "car"), "ini: PATH:2: unknown kind of base 'car'; use cer or ikart_V1"),
        (
            "base_control", "joints: [left, right]", BASE.replace("cer", "ikart_V1"),
            "joints: names 2, but a base of the kind ikart_V1 has 3 wheels",
        ),
        ("mapper2d", "", "[MAP]\nmap_width wide\n", "ini: PATH:2: 'map_width' must be a number, not 'wide'"),
        ("mapper2d", "width: 400.0, height: 400.0", "[MAP]\nmap_resolution 0.005\n", "resolution: a map of 400 by 400 m"),
        ("robot_goto", "", "", "ini: PATH: the group [ROBOT_TRAJECTORY] is missing"),
        ("robot_path_planner", "", "", "ini: PATH: the group [ROBOT_GEOMETRY] is missing"),
    ],
)  # fmt: skip
def test_a_modules_file_is_checked(name: str, keys: str, text: str, problem: str, tmp_path: Path) -> None:
    (file := tmp_path / "robot.ini").write_text(text)
    with pytest.raises(ConfigError) as caught:
        loads(module(name, f"ini: {file}, {keys}"))
    assert f": modules.{name}.{problem.replace('PATH', str(file))}" in str(caught.value)
    loads(module(name, f"ini: {file}, {keys}", enabled="false"))


@pytest.mark.parametrize(
    ("name", "keys", "text"),
    [
        ("base_control", "joints: [a, b, c]", BASE.replace("cer", "ikart_V1")),
        ("mapper2d", "width: 400.0, resolution: 0.005", "[MAP]\nmap_height 1\n"),
    ],
)
def test_a_modules_keys_are_checked_with_the_values_of_its_file(
    name: str, keys: str, text: str, tmp_path: Path
) -> None:
    (file := tmp_path / "robot.ini").write_text(text)
    assert loads(module(name, f"ini: {file}, {keys}"))


@pytest.mark.parametrize(
    ("name", "keys", "problem"),
    [
        ("base_control", "joints: [a]", "joints: names 1, but a base of the kind cer has 2 wheels"),
        ("localization_server", "localiser: {poor: 0.7}", "localiser.poor: 0.7 must be less than 'good' (0.6)"),
        ("map2d_server", "ports: [/a, /a]", "ports: two keys name the port /a"),
        ("map2d_server", "take: [{topic: /a, name: x}, {topic: /b, name: x}]", "take: two entries name the map x"),
        ("mapper2d", "width: 400.0, height: 400.0, resolution: 0.005", "resolution: a map of 400 by 400 m"),
        ("mapper3d", "nearest: 5", "nearest: 5 m is not nearer than farthest (4 m)"),
        ("robot_path_planner", "navigator: /navigate_to_pose", "navigator: /navigate_to_pose leads back"),
        ("robot_path_planner", "obstacles: [{topic: /c, type: cloud}]", "obstacles[0]: /c is a cloud"),
    ],
)  # fmt: skip
def test_keys_need_to_fit_together_only_in_an_enabled_module(name: str, keys: str, problem: str) -> None:
    with pytest.raises(ConfigError) as caught:
        loads(module(name, keys))
    assert f": modules.{name}.{problem}" in str(caught.value)
    loads(module(name, keys, enabled="false"))
    loads(f"modules: {{enabled: false, {name}: {{enabled: true, {keys}}}}}")


def test_a_clients_command_does_not_check_what_only_workers_use(tmp_path: Path) -> None:
    (ini := tmp_path / "robot.ini").write_text("")
    (file := tmp_path / "m.yaml").write_text(module("robot_goto", f"ini: {ini}"))
    assert load(file, client=True).modules.sections
    with pytest.raises(ConfigError):
        load(file)
