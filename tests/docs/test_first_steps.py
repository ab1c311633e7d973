"""Runs the first steps of the README."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import yaml

from bridge.demo.sandbox import hold_domain
from tests.support.missing import COMPILER, DART, need
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.wait import until

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
SECTION = re.search(r"^## First steps\n(.*?)^## ", README, re.MULTILINE | re.DOTALL)
TERMINALS = re.findall(r"^```sh\n(.*?)^```", SECTION[1] if SECTION else "", re.MULTILINE | re.DOTALL)
CONFIG = Path("configs/navigation.yaml")


@pytest.fixture
def folder() -> Iterator[Path]:
    """A project folder: the environment, and the configurations with free ports and a temporary state folder."""
    with tempfile.TemporaryDirectory(prefix="midspan-") as name:
        folder = Path(name)
        (folder / ".venv").symlink_to(sys.prefix)
        (folder / "configs").mkdir()
        for file in (ROOT / "configs").iterdir():
            (folder / "configs" / file.name).symlink_to(file)
        config: dict[str, Any] = yaml.safe_load((ROOT / CONFIG).read_text(encoding="utf-8"))
        config["state"] = str(folder / "state")
        config["hub"] = {**config.get("hub", {}), "listen": f"tcp/127.0.0.1:{free_port()}"}
        config["yarp"]["address"] = f"127.0.0.1:{free_port()}"
        (folder / CONFIG).unlink()
        (folder / CONFIG).write_text(yaml.safe_dump(config), encoding="utf-8")
        yield folder


@pytest.fixture
def environ() -> Iterator[Mapping[str, str]]:
    """The environment of a new terminal, with the test's ROS networks."""
    prefixes = ("ROS_", "MIDSPAN_", "VIRTUAL_ENV", "PYTHON")
    held, domain = hold_domain()
    with closing(held):
        ros = {"ROS_MASTER_URI": f"http://127.0.0.1:{free_port()}", "ROS_DOMAIN_ID": str(domain)}
        yield {name: value for name, value in os.environ.items() if not name.startswith(prefixes)} | ros


def test_all_commands_use_the_same_shipped_configuration() -> None:
    assert len(TERMINALS) == 2
    for terminal in TERMINALS:
        assert re.findall(r"^export MIDSPAN_CONFIG=(\S+)", terminal, re.MULTILINE) == [str(CONFIG)]
        assert "--config" not in terminal
    assert (ROOT / CONFIG).is_file()


@pytest.mark.thorough
@pytest.mark.timeout(400)
def test_every_line_succeeds(folder: Path, environ: Mapping[str, str]) -> None:
    for reason in (DART, COMPILER):
        need(reason)
    first, second = TERMINALS
    lines = [line.partition("#")[0].strip() for line in second.splitlines()]
    with Process(["bash", "-e", "-c", f"cd '{folder}'\n{first}"], environ) as daemon:

        def ready() -> bool:
            assert daemon.popen.poll() is None, daemon.output()
            return "ready:" in daemon.output()

        until(ready, "the first terminal shows 'ready:'", 90)
        # -x prints each command when it starts
        done = subprocess.run(
            ["bash", "-e", "-x", "-c", second], cwd=folder, env=environ, capture_output=True, text=True, timeout=280
        )
    assert done.returncode == 0, done.stderr[-3000:]
    started = [line.removeprefix("+ ") for line in done.stderr.splitlines() if line.startswith("+ midspan ")]
    assert len(started) == sum(line.startswith("midspan ") for line in lines)
    assert "kitchen" in done.stdout, "the map is shown with its places"
    assert "\narrived\n" in done.stdout, "the robot reaches the kitchen"
    assert "stands still" in done.stdout, "the robot stands in the end"
