"""``midspan module``, as a process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import yaml

from bridge.hub.node import Hub
from tests.peers.hub.quick import QuickHub
from tests.support.wait import until

ROOT = Path(__file__).parents[2]
COMMAND = [sys.executable, "-m", "bridge.cli.main", "module"]


def _config(folder: Path, endpoint: str) -> Path:
    file = folder / "midspan.yaml"
    modules = [{"name": "echo", "factory": "tests.peers.hub.echo:Echo"}]
    yarp = {"address": "127.0.0.1:9"}
    tree = {
        "name": "here",
        "state": str(folder),
        "hub": {"listen": endpoint},
        "modules": {"own": modules},
        "yarp": yarp,
    }
    file.write_text(yaml.safe_dump(tree))
    return file


def test_one_module_runs_alone_and_stops_cleanly(tmp_path: Path) -> None:
    hubs = QuickHub()
    try:
        env = {**os.environ, "PYTHONPATH": str(ROOT)}
        command = [*COMMAND, "echo", "--config", str(_config(tmp_path, hubs.endpoint))]
        program = subprocess.Popen(command, env=env, stderr=subprocess.PIPE, text=True)
        try:
            with Hub.open(hubs.settings("far")) as far:
                until(lambda: far.ask("status", {}, worker="echo"), "the module answers", 30)
                program.send_signal(signal.SIGTERM)
                assert program.wait(60) == 0
                until(lambda: not [n for n in far.graph.nodes() if n.node == "echo"], "the module's node has left")
        finally:
            program.kill()
            program.communicate()
    finally:
        hubs.stop_router()


def test_the_error_for_a_disabled_module_names_the_enabled_modules(tmp_path: Path) -> None:
    command = [*COMMAND, "nothing", "--config", str(_config(tmp_path, "tcp/127.0.0.1:9"))]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=100, check=False)
    assert done.returncode == 1
    assert "modules.nothing is not enabled" in done.stderr
    assert "echo" in done.stderr
