"""The command line and the workers import only what they use."""

from __future__ import annotations

import functools
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

_VERBS = ("status", "topic", "service", "nav", "goto", "explain", "action", "top")

_WORKERS = {
    "router": "bridge.hub.router",
    "ros1": "bridge.adapters.worker, bridge.adapters.ros1.environment",
    "ros2": "bridge.adapters.worker, bridge.adapters.ros2.environment",
    "yarp": "bridge.adapters.worker, bridge.adapters.yarp.edge",
    "zenoh": "bridge.adapters.worker, bridge.adapters.zenoh.dialects",
    "modules": "bridge.modules.worker",
    "sim": "sim.simulator",
    "record": "bridge.record.worker",
    "foxglove": "bridge.foxglove.worker",
}

_PROGRAMS = {
    "help": (
        "from contextlib import suppress; from bridge.cli.main import main\nwith suppress(SystemExit): main(['--help'])"
    ),
    "tf": "from bridge.cli.main import build_parser; build_parser(['tf'])",
    "verbs": f"from bridge.cli.main import build_parser; [build_parser([verb]) for verb in {_VERBS}]",
    "client": (
        "from pathlib import Path; from tempfile import TemporaryDirectory; from bridge.config.load import load\n"
        "with TemporaryDirectory() as folder:\n"
        "    (file := Path(folder, 'm.yaml')).write_text('sim: {enabled: true, start: [2.0, 2.0, 0.0]}')\n"
        "    assert load(file, client=True).sim.start"
    ),
    # every worker reads the built-in rules, so importing yaml would slow down each start
    "rules": "from bridge.messages.mapping.version_rules import built_in; assert len(built_in()) > 5",
    **{f"worker {name}": f"import bridge.daemon.worker_main, {modules}" for name, modules in _WORKERS.items()},
}

_RUN_EACH = """
import json, os, sys
plain = json.loads(sys.argv[1])
workers = {name: plain.pop(name) for name in list(plain) if name.startswith("worker ")}
for name, code in [*plain.items(), ("", "import bridge.cli.daemon.run, bridge.daemon.worker_main"), *workers.items()]:
    if not name:
        exec(code)  # what all workers import
    elif (child := os.fork()) == 0:
        exec(code, {})
        print("\\n" + json.dumps([name, list(sys.modules)]), flush=True)
        os._exit(0)
    elif os.waitpid(child, 0)[1]:
        sys.exit(f"{name} failed")
"""
"""Runs each program in a fork of an interpreter that has imported nothing yet, or what all workers import."""


@functools.cache
def loaded() -> dict[str, set[str]]:
    """Return the modules that an interpreter has imported after running each of the programs."""
    command = [sys.executable, "-P", "-c", _RUN_EACH, json.dumps(_PROGRAMS)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith('["')]
    return {name: set(modules) for name, modules in lines}


def test_help_loads_none_of_the_libraries() -> None:
    assert not loaded()["help"] & {"pydantic", "zenoh", "numpy", "rich", "yaml", "ruamel.yaml", "bridge.cli.client"}


def test_daemon_verbs_load_no_message_types_at_start() -> None:
    others = {"numpy", "PIL", "ruamel.yaml", "sqlite3", "bridge.messages.registry", "bridge.messages.transcode"}
    assert not loaded()["verbs"] & others


def test_tf_verb_loads_no_conversions() -> None:
    assert not loaded()["tf"] & {"PIL", "ruamel.yaml", "bridge.messages.transcode", "bridge.routing.edge"}


def test_a_clients_configuration_loads_no_libraries_of_the_workers() -> None:
    assert not loaded()["client"] & {"numpy", "sim.plan", "zenoh"}


@pytest.mark.parametrize("worker", _WORKERS)
def test_worker_loads_no_libraries_of_the_command_line_or_other_sides(worker: str) -> None:
    others = {"rospy", "rclpy", "dartpy", "rich", "PIL", "cryptography", "yaml", "bridge.config.load"}
    if worker != "sim":
        others |= {"yaml", "rosbags"}  # for user-defined mapping rules, static transforms, types without a package
    if worker in ("modules", "sim"):
        others |= {"bridge.routing.engine", "bridge.adapters.worker"}
    if worker == "sim":
        others -= {"dartpy", "yaml"}  # the physics engine, and the reader of floor-plan files
    if worker == "router":
        others |= {"numpy", "bridge.messages.registry"}
    assert not loaded()[f"worker {worker}"] & others


def test_the_built_in_rules_need_no_yaml() -> None:
    assert "yaml" not in loaded()["rules"]


def test_no_program_imports_a_library_that_the_debian_package_does_not_compile() -> None:
    """The services' user cannot write the bytecode, so each start would compile the library."""
    postinst = (Path(__file__).parents[2] / "packaging/debian/postinst").read_text(encoding="utf-8")
    excluded = re.search(r" -x '/\(([\w|?]+)\)/' ", postinst)
    assert excluded
    parts = re.compile(rf"(^|\.)({excluded[1]})(\.|$)")
    assert sorted({name for modules in loaded().values() for name in modules if parts.search(name)}) == []
