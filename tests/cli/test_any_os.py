"""The command line runs on any OS: tested in a separate process in which everything that Windows lacks is hidden."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from bridge.hub.session import Hub
from bridge.messages.registry import Registry
from tests.contract.hubside import HubSide
from tests.peers.daemon.workers import config_file
from tests.peers.hub.quick import QuickHub
from tests.support.hidden import as_on

COMMANDS = """
import json
import sys

from bridge.cli.main import main

config = sys.argv[1]
for words in json.loads(sys.stdin.read()):
    print("##", *words, flush=True)
    try:
        code = main([config if word == "FILE" else word for word in words])
    except SystemExit as end:
        code = end.code
    print("=>", code, flush=True)
"""


@pytest.fixture
def hub() -> Iterator[QuickHub]:
    """A hub for one test."""
    quick_hub = QuickHub()
    yield quick_hub
    quick_hub.stop_router()


def run(config: Path, *commands: str) -> dict[str, tuple[int, str]]:
    """Run commands one after the other; return the exit code and output of each."""
    argv_json = str([command.split() for command in commands]).replace("'", '"')
    done = subprocess.run(
        [sys.executable, "-c", COMMANDS, config],
        input=argv_json, env=as_on("windows"), stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        text=True, timeout=100, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    runs = {}
    for part in done.stdout.split("## ")[1:]:
        command, _, remainder = part.partition("\n")
        output, _, code = remainder.rpartition("=> ")
        runs[command] = int(code.split()[0]), output
    return runs


def test_verbs_work_on_other_systems(hub: QuickHub, tmp_path: Path) -> None:
    folder = tmp_path / "big path"
    folder.mkdir()
    config = config_file(folder, hub)
    far = HubSide(Hub.open(hub.settings("far")), Registry())
    try:
        far.publish(far.advertise("/word", "std_msgs/String", latched=True), {"data": "there"})
        runs = run(
            config,
            "config check FILE",
            "topic list --config FILE",
            "topic echo /word --count 1 --config FILE",
            "doctor --only config --config FILE",
            "status --config FILE",
            "record --all --output aux.mcap --config FILE",
            "install",
        )
    finally:
        far.hub.close()
    assert runs["config check FILE"][0] == 0, runs
    assert (runs["topic list --config FILE"][0], "/word" in runs["topic list --config FILE"][1]) == (0, True), runs
    code, text = runs["topic echo /word --count 1 --config FILE"]
    assert (code, "data: there" in text) == (0, True), runs
    assert runs["doctor --only config --config FILE"][0] == 0, runs
    assert "AttributeError" not in runs["status --config FILE"][1], runs
    code, text = runs["record --all --output aux.mcap --config FILE"]
    assert (code, "aux.mcap is not a file name on Windows" in text) == (1, True), runs
    assert "systemd exists only on Linux" in runs["install"][1]
