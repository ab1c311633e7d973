"""The command line and the workers import only what they use."""

from __future__ import annotations

import subprocess
import sys

import pytest

_TELL = "; import sys; print(' '.join(sys.modules))"


def loaded(code: str) -> set[str]:
    """Return the modules that an interpreter has imported after running some code."""
    completed = subprocess.run([sys.executable, "-P", "-c", code + _TELL], capture_output=True, text=True, check=True)
    return set(completed.stdout.splitlines()[-1].split())


def test_help_loads_none_of_the_libraries() -> None:
    code = (
        "from contextlib import suppress; from bridge.cli.main import main\n"
        "with suppress(SystemExit): main(['--help'])\n0"
    )
    assert not loaded(code) & {"pydantic", "zenoh", "numpy", "rich", "yaml", "ruamel.yaml", "bridge.cli.client"}


@pytest.mark.parametrize("verb", ["status", "topic", "service", "nav", "goto", "explain", "action", "top"])
def test_daemon_verbs_load_no_message_types_at_start(verb: str) -> None:
    modules = loaded(f"from bridge.cli.main import build_parser; build_parser([{verb!r}])")
    others = {"numpy", "PIL", "ruamel.yaml", "sqlite3", "bridge.messages.registry", "bridge.messages.transcode"}
    assert not modules & others


def test_tf_verb_loads_no_conversions() -> None:
    modules = loaded("from bridge.cli.main import build_parser; build_parser(['tf'])")
    assert not modules & {"PIL", "ruamel.yaml", "bridge.messages.transcode", "bridge.routing.edge"}


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
    modules = loaded(f"import bridge.cli.daemon.run, bridge.daemon.worker_main, {_WORKERS[worker]}") & others
    assert not modules


def test_the_built_in_rules_need_no_yaml() -> None:
    """Every worker reads the built-in rules, so importing yaml would slow down each start."""
    code = "from bridge.messages.mapping.version_rules import built_in; assert len(built_in()) > 5"
    assert "yaml" not in loaded(code)
