"""The steps in docs/operate/console.md open the console on the network."""

from __future__ import annotations

import json
import os
import re
import shlex
import ssl
import subprocess
import sys
import urllib.request
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.peers.browser.page import TestPage
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.wait import until

PAGE = Path(__file__).parents[2] / "docs" / "operate" / "console.md"
MIDSPAN = [sys.executable, "-m", "bridge.cli.main"]


class Steps:
    """The commands and the configuration in the page's section, used in a folder."""

    def __init__(self, folder: Path) -> None:
        section = PAGE.read_text().partition("### Open it on the network")[2]
        lines = "".join(re.findall(r"```sh\n(.*?)```", section, re.DOTALL)).splitlines()
        self.commands = [shlex.split(line)[1:] for line in lines]
        (self._yaml,) = re.findall(r"```yaml\n(.*?)```", section, re.DOTALL)
        self.file = folder / "midspan.yaml"
        self._folder = folder
        self._env = {**os.environ, "XDG_CONFIG_HOME": str(folder)}

    def run(self, command: list[str], *, config: bool = False) -> str:
        """Return the output of a command."""
        more = ["--config", str(self.file)] if config else []
        done = subprocess.run(
            [*MIDSPAN, *command, *more], capture_output=True, text=True, timeout=60, check=True, env=self._env
        )
        return done.stdout

    def configure(self, printed: list[str]) -> int:
        """Write the page's configuration with the commands' output; return the console's port."""
        config: dict[str, Any] = yaml.safe_load(self._yaml)
        for text in printed:
            document: dict[str, Any] = yaml.safe_load(text[text.index("web:") :])
            for name, token in document["web"]["tokens"].items():
                assert config["web"]["tokens"][name]["role"] == token["role"]
                config["web"]["tokens"][name] = token
        port = free_port()
        config["web"]["listen"] = f"127.0.0.1:{port}"
        off = {side: {"enabled": False} for side in ("ros1", "ros2", "yarp")}
        hub = {"listen": f"tcp/127.0.0.1:{free_port()}", "open": {"keys": str(self._folder / "midspan" / "keys")}}
        self.file.write_text(yaml.safe_dump({**config, **off, "hub": hub, "state": str(self._folder / "state")}))
        return port


def test_the_documented_steps_open_the_console(tmp_path: Path) -> None:
    steps = Steps(tmp_path)
    keys, anna, hall, doctor, web = steps.commands
    assert "for connecting to robot1, robot1.local, 192.168.1.20" in steps.run([*keys, "127.0.0.1"])
    printed = [steps.run(command) for command in (anna, hall)]
    port = steps.configure(printed)
    assert "browsers accept the console as robot1" in steps.run(doctor, config=True)
    daemon = Process([*MIDSPAN, "run", "--config", steps.file])
    try:
        output = until(lambda: address(steps, web), f"the address is printed; {daemon.output()[-2000:]}", 60)
        assert output[0] == f"https://robot1:{port}/"
        assert any("ca.pem" in line for line in output)
        assert any("anna (drive), hall (watch)" in line for line in output)
        for text, role in zip(printed, ("drive", "watch"), strict=True):
            token = re.findall(r"^  (\S{40,})$", text, re.MULTILINE)[0]
            assert logged_in(tmp_path, port, token) == role
            assert token not in daemon.output()
    finally:
        daemon.stop()


def address(steps: Steps, command: list[str]) -> list[str]:
    try:
        return steps.run(command, config=True).splitlines()
    except subprocess.CalledProcessError:
        return []


def logged_in(folder: Path, port: int, token: str) -> str:
    """Return the role of a token, as reported for a login and for a socket."""
    context = ssl.create_default_context(cafile=folder / "midspan" / "keys" / "ca.pem")
    origin = f"https://127.0.0.1:{port}"
    request = urllib.request.Request(f"{origin}/login", json.dumps({"token": token}).encode(), {"Origin": origin})
    with urllib.request.urlopen(request, timeout=10, context=context) as answer:
        role = str(json.load(answer)["role"])
    with TestPage(port, ssl=context, additional_headers={"Authorization": f"Bearer {token}"}) as page:
        page.until(lambda: page.others, "the hello arrives")
        assert page.others[0]["role"] == role
    return role


@pytest.mark.parametrize("name", ["a b", "", "x" * 64, "-a"])
def test_a_token_needs_a_valid_name(name: str) -> None:
    done = subprocess.run([*MIDSPAN, "web", f"--token={name}"], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert "is not a name" in done.stderr
