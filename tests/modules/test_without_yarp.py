"""Modules without YARP, which is disabled or not used on this machine."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.config.model import Config
from bridge.modules.ports import Ports
from tests.peers.daemon.robot_daemon import OFF, RobotDaemon
from tests.peers.hub.modules import Place
from tests.support.ports import free_port
from tests.support.wait import until
from yarp_compat.naming.server import NameServer
from yarp_compat.ports.naming import NoNameServerError


def ports_of(folder: Path, **yarp: Any) -> Ports:
    return Ports(Config.model_validate({"name": "here", "state": folder, "yarp": yarp}), "test")


@pytest.fixture
def no_conf(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """YARP's configuration folder, without a yarp.conf."""
    monkeypatch.setenv("YARP_CONFIG_HOME", str(tmp_path / "conf"))
    monkeypatch.delenv("YARP_NAMESPACE", raising=False)
    return tmp_path


@pytest.mark.parametrize("named", [False, True], ids=["no name server", "a name server"])
def test_disabled_ports_do_not_look_for_a_name_server(no_conf: Path, named: bool) -> None:
    number = free_port()
    with NameServer(port=number, gc_seconds=0):
        before = set(threading.enumerate())
        ports = ports_of(no_conf, enabled=False, **({"address": f"127.0.0.1:{number}"} if named else {}))
        port = ports.output("/said:o")
        ports.respond("/rpc", lambda values: values)
        assert (port.write([1]), ports.trouble(), ports.status()) == (0, "", [])
        assert set(threading.enumerate()) <= before, "only threads of earlier tests may end meanwhile"
        with pytest.raises(NoNameServerError, match=r"YARP is switched off \(yarp.enabled: false\)"):
            ports.naming.query("/said:o")
        ports.close()


def test_no_problem_is_reported_if_no_name_server_is_configured(no_conf: Path) -> None:
    ports = ports_of(no_conf)
    port = ports.output("/said:o")
    until(lambda: "no address of YARP" in port.trouble, "the port has looked for a name server")
    assert ports.trouble() == ""
    assert ports.status()[0]["state"] == "waiting"
    number = free_port()
    with NameServer(port=number, gc_seconds=0):
        (no_conf / "conf").mkdir()
        (no_conf / "conf" / "yarp.conf").write_text(f"127.0.0.1 {number} yarp\n")
        until(lambda: not port.trouble, "the port is registered once yarp.conf names a server")
        ports.close()


@pytest.mark.parametrize("yarp", [{"enabled": True}, {"namespace": "/lab"}])
def test_a_missing_name_server_is_reported_if_yarp_is_used(no_conf: Path, yarp: dict[str, Any]) -> None:
    ports = ports_of(no_conf, **yarp)
    ports.output("/said:o")
    until(lambda: "no address of YARP" in ports.trouble(), "the problem is reported")
    ports.close()


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    with Place(tmp_path) as running:
        yield running


def test_a_reload_switches_the_ports_of_modules(place: Place) -> None:
    off = place.config(yarp=place.yarp_section(enabled=False))
    place.worker.start(off)
    assert not place.worker.reload(place.config()), "the worker restarts to open the ports"
    assert place.worker.reload(place.config(yarp=place.yarp_section(enabled=False, poll=1.0)))


def test_the_daemon_s_ready_line_does_not_mention_yarp(tmp_path: Path) -> None:
    robot = RobotDaemon(tmp_path)
    assert OFF["yarp"] == {"enabled": False}
    try:
        robot.run()
        robot.until_phase("modules", "running")
        assert robot.daemon is not None
        output = robot.daemon.output
        line = until(lambda: re.search(r"ready: .*", output()), "the daemon is ready", 40)
        status = robot.command("status")
        for text in (line[0], status.stdout, str(robot.worker("modules")["text"])):
            assert "YARP" not in text
            assert "yarp" not in text
        assert "without a connection" not in status.stdout
    finally:
        robot.close()
