"""``midspan ros1 master``: a master in the foreground."""

from __future__ import annotations

import os
import sys
import xmlrpc.client
from pathlib import Path
from typing import Any

import pytest

from bridge.cli.main import main
from tests.support.forks import DAEMON
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.wait import until


def test_a_master_keeps_its_state_and_ends_by_the_shutdown_call(tmp_path: Path):
    port = free_port()
    config = tmp_path / "midspan.yaml"
    config.write_text(f"name: test\nstate: {tmp_path / 'state'}\n")
    command = [sys.executable, "-m", "bridge.cli.main", "ros1", "master", "-p", str(port), "-c", str(config)]
    env = {name: value for name, value in os.environ.items() if not name.startswith(("MIDSPAN_", "ROS_"))}

    def call(method: str, *params: Any) -> Any:
        with xmlrpc.client.ServerProxy(f"http://{host}:{port}/") as proxy:
            return getattr(proxy, method)("/node", *params)[2]  # type: ignore[index]

    def run(*options: str) -> Process:
        process = Process([*command, *options], env, imports=DAEMON)
        until(lambda: _answers(call), "the master answers")
        return process

    for options, host, value in (
        ((), "127.0.0.1", {}), ((), "127.0.0.1", 5), (("--forget", "--listen", "[::1]:1"), "[::1]", {}),
    ):  # fmt: skip
        with run(*options) as process:
            assert call("getUri") == f"http://{host}:{port}/"
            prefix = f"http://{host}:"
            until(lambda: call("lookupNode", "/rosout").startswith(prefix), "the master's rosout registers")  # noqa: B023
            assert call("subscribeParam", "http://127.0.0.1:1/", "/x") == value
            call("setParam", "/x", 5)
            assert call("shutdown", "done") == 0
            assert process.popen.wait(40) == 0


def _answers(call: Any) -> bool:
    try:
        return bool(call("getPid"))
    except OSError:
        return False


@pytest.mark.parametrize(
    ("options", "error"),
    [
        (["--listen", "here"], "not an address with a port"),
        (["--port", "0"], "no fixed port"),
        (["--port", "99999"], "not an address with a port"),
        (["--purge", "-1"], "greater than or equal to 0"),
    ],
)
def test_invalid_options_are_errors(tmp_path: Path, options: list[str], error: str, capsys: pytest.CaptureFixture[str]):
    config = tmp_path / "midspan.yaml"
    config.write_text(f"name: test\nstate: {tmp_path / 'state'}\n")
    assert main(["ros1", "master", "-c", str(config), *options]) == 1
    assert error in capsys.readouterr().err
