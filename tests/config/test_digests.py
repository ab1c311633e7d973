"""The contents of the files that a configuration names belong to it: a reload compares them like values."""

# ruff: noqa: E501  each case is a few lines

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bridge.config.load import load
from bridge.config.model import Config
from bridge.config.received import ReceivedConfig
from bridge.daemon.protocol import NewConfig, decode_command, encode_command
from bridge.daemon.workers import worker_kinds

WHEELS = "[BASECTRL_GENERAL]\nrobot_type cer\nmax_linear_vel 0.3\nmax_angular_vel 30\n"
GEOMETRY = "[ROBOT_GEOMETRY]\ngeom_r 0.1\ngeom_L 0.3\n"
BASE = f"{WHEELS}{GEOMETRY}"
PROFILE = (
    '<dds><profiles><participant profile_name="p" is_default_profile="true"><rtps><name>NAME</name></rtps>'
    "</participant></profiles></dds>"
)
GRID = "resolution: 1.0\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
PLAN = "walls: [[[0, 0], [WIDTH, 0]]]\nstart: [2, 2, 0]\n"
RULES = "- {ros1_package_name: a_msgs, ros1_message_name: A, ros2_package_name: b_msgs, ros2_message_name: NAME}\n"
IMAGE = b"P5\n8 8\n255\n"

SIDES = {"ros1", "ros2", "yarp", "zenoh"}
SERVERS = {"web", "foxglove", "metrics"}
ALL = {*SIDES, *SERVERS, "modules", "sim", "record", "router", "ros1_master"}
OF_MODULES = {*SIDES, *SERVERS, "modules"}


def reloaded(before: Config, after: Config) -> set[str]:
    """Return the workers that are reloaded."""
    kinds = worker_kinds({})
    return {name for name, kind in kinds.items() if kind.config_part(before) != kind.config_part(after)}


@pytest.mark.parametrize(
    ("config", "files", "changed", "workers"),
    [
        ("modules: {base_control: {enabled: true, ini: a}}", {"a": BASE}, ("a", "0.3", "0.4"), OF_MODULES),
        (
            "modules: {base_control: {enabled: true, ini: a}}",
            {"a": f'{WHEELS}[include "b"]\n', "b": GEOMETRY}, ("b", "0.3", "0.4"), OF_MODULES,
        ),
        ("modules: {mapper2d: {enabled: true, ini: a}}", {"a": "[MAP]\nmap_width 5\n"}, ("a", "5", "6"), OF_MODULES),
        ("hub: {zenoh: a.json5}", {"a.json5": "{scouting: {delay: 7}}"}, ("a.json5", "7", "8"), ALL),
        ("hub: {router_zenoh: a.yaml}", {"a.yaml": "scouting: {delay: 7}"}, ("a.yaml", "7", "8"), ALL),
        (
            "hub: {open: {listen: tcp/127.0.0.1:7448, insecure: true, zenoh: a.json5}}",
            {"a.json5": "{scouting: {delay: 7}}"}, ("a.json5", "7", "8"), {"router"},
        ),
        (
            "zenoh: {zenoh: a.json5, dialects: [{dialect: ros2dds}]}",
            {"a.json5": "{scouting: {delay: 7}}"}, ("a.json5", "7", "8"), {"zenoh"},
        ),
        (
            "hub: {zenoh: {transport: {auth: {usrpwd: {user: u, password: p, dictionary_file: FOLDER/a}}}}}",
            {"a": "u:p\n"}, ("a", "u:p", "u:q"), ALL,
        ),
        (
            "hub: {zenoh: a.json5}",
            {"a.json5": '{transport: {auth: {usrpwd: {user: "u", password: "p", dictionary_file: "FOLDER/b"}}}}', "b": "u:p"},
            ("b", "u:p", "u:q"), ALL,
        ),
        # the router and the servers watch these files themselves
        ("hub: {open: {listen: tls/127.0.0.1:7448, ca: a}}", {"a": "old"}, ("a", "old", "new"), set()),
        ("ros2: {profile: a}", {"a": PROFILE}, ("a", "NAME", "OTHER"), {"ros2"}),
        ("ros1: {packages: a}", {"a/b_msgs/msg/_B.py": "old"}, ("a/b_msgs/msg/_B.py", "old", "new"), {"ros1", "ros1_master"}),
        ("types: {folders: a}", {"a/b_msgs/msg/B.msg": "int8 b\n"}, ("a/b_msgs/msg/B.msg", "int8", "int16"), ALL - {"router", "ros1_master"}),
        ("types: {folders: a}", {"a/A.msg": "int8 b\n"}, ("a/B.msg", "", "int8 b\n"), ALL - {"router", "ros1_master"}),
        ("types: {mapping_rules: a}", {"a": RULES}, ("a", "NAME", "OTHER"), ALL - {"router", "ros1_master"}),
        ("store: {maps: a.map}", {"a.map": "MapName a\n"}, ("a.map", "a", "b"), {"modules"}),
        ("store: {locations: a.ini}", {"a.ini": "a"}, ("a.ini", "a", "b"), {"modules"}),
        ("store: {locations: a.ini}", {"a.ini": "a"}, ("a_extras.ini", "", "b"), {"modules"}),
        ("sim: {enabled: true, plan: a.yaml}", {"a.yaml": PLAN.replace("WIDTH", "5")}, ("a.yaml", "5", "6"), {"sim"}),
        (
            "sim: {enabled: true, plan: a.yaml, start: [4, 4, 0]}",
            {"a.yaml": f"image: b.pgm\n{GRID}", "b.pgm": IMAGE + b"\xff" * 64}, ("b.pgm", b"\xff", b"\xfe"), {"sim"},
        ),
        (
            "sim: {enabled: true, plan: a.map, start: [4, 4, 0]}",
            {"a.map": "MapName a\nRosMapData a.yaml\n", "a.yaml": f"image: b.pgm\n{GRID}", "b.pgm": IMAGE + b"\xff" * 64},
            ("b.pgm", b"\xff", b"\xfe"), {"sim"},
        ),
    ],
)  # fmt: skip
def test_a_changed_file_reloads_the_workers_that_a_changed_key_reloads(
    config: str,
    files: dict[str, str | bytes],
    changed: tuple[str, str | bytes, str | bytes],
    workers: set[str],
    tmp_path: Path,
) -> None:
    for name, content in files.items():
        write(tmp_path / name, content, tmp_path)
    (file := tmp_path / "midspan.yaml").write_text(config.replace("FOLDER", str(tmp_path)))
    before, same = load(file), load(file)
    assert not reloaded(before, same)
    name, old, new = changed
    content = files.get(name, "")
    if isinstance(content, bytes):
        assert isinstance(old, bytes)
        assert isinstance(new, bytes)
        write(tmp_path / name, content.replace(old, new), tmp_path)
    else:
        write(tmp_path / name, content.replace(str(old), str(new)), tmp_path)
    assert reloaded(before, load(file)) == workers


def write(file: Path, content: str | bytes, folder: Path) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(content.replace("FOLDER", str(folder)).encode() if isinstance(content, str) else content)


def sent(config: Config, parse: Callable[[dict[str, Any]], Config]) -> Config:
    command = decode_command(encode_command(NewConfig(config)), parse)
    assert isinstance(command, NewConfig)
    return command.config


@pytest.mark.parametrize("parse", [Config.model_validate, ReceivedConfig.of])
def test_a_worker_sees_the_same_change(parse: Callable[[dict[str, Any]], Config], tmp_path: Path) -> None:
    (profile := tmp_path / "p.xml").write_text(PROFILE)
    (base := tmp_path / "base.ini").write_text(BASE)
    (file := tmp_path / "midspan.yaml").write_text(
        f"ros2: {{profile: {profile}}}\nmodules: {{base_control: {{enabled: true, ini: {base}}}}}"
    )
    before, config = sent(load(file), Config.model_validate), load(file)
    assert sent(config, parse) == before == config
    base.write_text(BASE.replace("0.3", "0.4"))
    after = sent(load(file), parse)
    assert after != before
    assert after.ros2 == before.ros2
    assert after.hosted["base_control"] != before.hosted["base_control"]


def test_files_of_what_is_disabled_and_files_that_midspan_writes_are_not_read(tmp_path: Path) -> None:
    (ini := tmp_path / "base.ini").write_text(BASE)
    (file := tmp_path / "midspan.yaml").write_text(
        f"modules: {{base_control: {{enabled: false, ini: {ini}}}, mapper2d: {{enabled: true, folder: .}}}}\n"
        "record: {enabled: true, folder: .}\n"
    )
    before = load(file)
    ini.write_text("")
    assert load(file) == before
