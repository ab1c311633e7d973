"""The command line runs on any OS: tested in a separate process in which everything that Windows lacks is hidden."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from bridge.hub.node import Hub
from bridge.messages.registry import Registry
from tests.contract.hubside import HubSide
from tests.peers.daemon.workers import config_file
from tests.peers.hub.quick import QuickHub
from tests.peers.hub.recorded_robot import read
from tests.support.hidden import as_on
from tests.support.process import Process
from tests.support.wait import SLOWNESS, until

MIDSPAN = [sys.executable, "-P", "-m", "bridge.cli.main"]
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
            f"keys make robot1 --folder {tmp_path}/keys",
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
    assert runs[f"keys make robot1 --folder {tmp_path}/keys"][0] == 0, runs


@pytest.mark.parametrize("place", ["", "--folder", "--ring 1h --trigger /go"])
def test_a_recording_has_unchanged_bytes_on_every_system(hub: QuickHub, tmp_path: Path, place: str) -> None:
    """Its bytes are not changed, as those of a text file would be, and its files are moved and replaced."""
    config, folder = config_file(tmp_path, hub), tmp_path / "recordings"
    word = {"data": "one\ntwo\r\n" * 1000}
    output = folder if place.startswith("--ring") else folder / "r.mcap"
    command = ["record", "/word", "--compression", "none", "--output", str(output), "--config", str(config)]
    folder.mkdir()
    far = HubSide(Hub.open(hub.settings("far")), Registry())
    try:
        far.publish(far.advertise("/word", "std_msgs/String", latched=True), word)
        go = far.advertise("/go", "std_msgs/String")
        with Process([*MIDSPAN, *command, *place.split()], as_on("windows")) as process:

            def recorded() -> bool:
                assert process.popen.poll() is None, process.output()
                if "--trigger" in place:
                    far.publish(go, {"data": ""})
                    return any(folder.glob("*/metadata.yaml"))
                return any(file.stat().st_size > len(word["data"]) for file in folder.rglob("*.mcap"))

            until(recorded, "the message is recorded", 40, every=0.1)
            process.signal(signal.SIGINT)
            assert process.popen.wait(20 * SLOWNESS) == 0, process.output()
    finally:
        far.hub.close()
    (file,) = folder.rglob("*.mcap")
    contents = read(file)
    assert contents.whole
    assert [word["data"].encode() in message.data for message in contents.messages] == [True]
    assert any(file.parent.glob("metadata.yaml")) == bool(place)
