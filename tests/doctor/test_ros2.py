"""Checks of ROS 2's settings, and of bridges on a real DDS network."""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path

import pytest

from bridge.adapters.ros2 import discovery
from bridge.config.model import Config
from bridge.daemon.workers import worker_kinds
from bridge.doctor.check import Result
from bridge.doctor.checks import bridges, ros2
from tests.doctor.parts import around, every, hub, only, results
from tests.peers.peer import Peer
from tests.peers.ros2.network import ROS2_PEER, ros2_domain, ros2_environment, ros2_python
from tests.support.missing import ROS2, needs
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.wait import until

OTHER_MIDSPAN = """
import json, pathlib, sys, threading
from bridge.adapters.ros2.participant import Participant
from bridge.adapters.ros2.profile import use_profile
from bridge.config.model import Config
profile = use_profile(Config(), pathlib.Path(sys.argv[1]))
participant = Participant("midspan", int(sys.argv[2]))
print(profile.prefix.hex(), flush=True)
sys.stdin.read()
participant.close()
"""


@pytest.fixture
def _servers_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """Find no discovery server that does not run: whether an address is unreachable depends on this machine."""
    monkeypatch.setattr(discovery, "failing", lambda _servers: [])


@pytest.mark.usefixtures("_servers_run")
@pytest.mark.parametrize(
    ("environ", "config", "result", "words"),
    [
        ({}, {}, Result.OK, "domain 0"),
        ({"ROS_DOMAIN_ID": "7"}, {}, Result.OK, "domain 7"),
        ({"ROS_DOMAIN_ID": "7"}, {"domain": 8}, Result.WARN, "export ROS_DOMAIN_ID=8"),
        ({}, {"domain": 8}, Result.WARN, "export ROS_DOMAIN_ID=8"),
        ({"ROS_DOMAIN_ID": "seven"}, {}, Result.FAIL, "not a number"),
        ({"ROS_DOMAIN_ID": "233"}, {}, Result.FAIL, "not a number"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, {}, Result.FAIL, "discover nothing"),
        ({"ROS_LOCALHOST_ONLY": "1"}, {"localhost_only": False}, Result.WARN, "discover only this machine"),
        ({"ROS_LOCALHOST_ONLY": "1"}, {}, Result.OK, ""),
        ({"FASTRTPS_DEFAULT_PROFILES_FILE": "/nowhere.xml"}, {}, Result.WARN, "/nowhere.xml"),
        ({"ROS_DOMAIN_ID": "x"}, {"enabled": False}, Result.SKIP, ""),
        ({"ROS_STATIC_PEERS": "10.0.0.2"}, {}, Result.WARN, "set ros2.localhost_only: false"),
        ({"ROS_STATIC_PEERS": "10.0.0.2"}, {"localhost_only": False}, Result.OK, ""),
        ({"ROS_SECURITY_ENABLE": "true"}, {}, Result.OK, ""),
        ({"ROS_DISCOVERY_SERVER": "192.0.2.1"}, {}, Result.WARN, "names 192.0.2.1:11811, but ros2.localhost_only"),
        ({"ROS_DISCOVERY_SERVER": "192.0.2.1"}, {"localhost_only": False}, Result.OK, ""),
        ({"ROS_DISCOVERY_SERVER": "192.0.2.1"}, {"rmw": "rmw_cyclonedds_cpp"}, Result.OK, ""),
    ],
)
def test_the_environment_of_ros2_is_checked(
    environ: dict[str, str], config: dict[str, object], result: Result, words: str
) -> None:
    finding = only(ros2.check_environment(around({"ros2": config}, environ)))
    assert finding.result is result
    assert words in f"{finding.seen} {finding.cure}"


@pytest.mark.parametrize(
    ("config", "limit", "result", "words"),
    [
        ({}, "212992", Result.SKIP, "large messages use shared memory"),
        ({"enabled": False, "localhost_only": False}, "212992", Result.SKIP, "ros2.enabled is false"),
        ({"localhost_only": False}, "212992", Result.WARN, "write net.core.rmem_max=4194304 to /etc/sysctl.d/90-ros2"),
        ({"transport": "udp"}, "212992", Result.WARN, "net.core.rmem_max is 212992, less than 4194304"),
        ({"profile": "own.xml"}, "212992", Result.WARN, "sudo sysctl --system"),
        ({"rmw": "rmw_cyclonedds_cpp"}, "212992", Result.WARN, "over UDP are lost"),
        ({"localhost_only": False}, "4194304", Result.OK, "use net.core.rmem_default, which is 212992"),
        ({"localhost_only": False}, None, Result.SKIP, "in a container"),
    ],
)
def test_the_kernels_receive_buffers_are_checked(
    tmp_path: Path, config: dict[str, object], limit: str | None, result: Result, words: str
) -> None:
    core = tmp_path / "sys/net/core"
    core.mkdir(parents=True)
    (core / "rmem_default").write_text("212992\n")
    if limit is not None:
        (core / "rmem_max").write_text(f"{limit}\n")
    finding = only(ros2.check_buffers(around({"ros2": config}, proc=tmp_path)))
    assert finding.result is result
    assert words in f"{finding.seen} {finding.cure}"


def test_a_shell_with_another_domain_than_the_running_daemons_is_reported() -> None:
    env = {**os.environ, "ROS_DOMAIN_ID": "23"}
    with Process([sys.executable, "-c", "import sys; sys.stdin.read()", "midspan"], env, pipes=True) as worker:
        until(lambda: Path(f"/proc/{worker.pid}/cmdline").read_bytes().count(b"midspan"), "the worker runs")
        view = hub({"worker": "ros2", "side": "ros2", "pid": worker.pid})
        finding = only(ros2.check_environment(around(environ={"ROS_DOMAIN_ID": "5"}, hub=view)))
    assert finding.result is Result.WARN
    assert "the running daemon uses 23" in finding.seen


@pytest.mark.parametrize(("mine", "result"), [("", Result.WARN), ("10.0.0.1:11811", Result.OK)])
@pytest.mark.usefixtures("_servers_run")
def test_a_shell_without_the_daemons_discovery_server_is_a_warning(mine: str, result: Result) -> None:
    env = {**os.environ, "ROS_DISCOVERY_SERVER": "10.0.0.1:11811"}
    with Process([sys.executable, "-c", "import sys; sys.stdin.read()", "midspan"], env, pipes=True) as worker:
        until(lambda: Path(f"/proc/{worker.pid}/cmdline").read_bytes().count(b"midspan"), "the worker runs")
        view = hub({"worker": "ros2", "side": "ros2", "pid": worker.pid})
        environ = {"ROS_DISCOVERY_SERVER": mine}
        finding = only(ros2.check_environment(around({"ros2": {"localhost_only": False}}, environ, hub=view)))
    assert finding.result is result
    assert result is Result.OK or "not set in this shell, 10.0.0.1:11811 for the daemon" in finding.seen


def test_a_missing_discovery_server_is_reported() -> None:
    port = free_port()
    finding = only(ros2.check_environment(around(environ={"ROS_DISCOVERY_SERVER": f"127.0.0.1:{port}"})))
    assert finding.result is Result.WARN
    assert f"no discovery server receives at 127.0.0.1:{port}" in finding.seen


@pytest.mark.usefixtures("_servers_run")
def test_a_discovery_server_that_restarted_after_the_worker_is_reported() -> None:
    """The kernel counts start times in hundredths of a second, so each program starts once the previous one runs."""
    port = free_port()
    environ = {"ROS_DISCOVERY_SERVER": f"127.0.0.1:{port};10.0.0.1"}
    bind = f"import socket; s = socket.socket(type=socket.SOCK_DGRAM); s.bind(('127.0.0.1', {port}))"

    def running(stack: contextlib.ExitStack, setup: str = "") -> Process:
        program = f"import sys\n{setup}\nprint('up', flush=True)\nsys.stdin.read()"
        command = [sys.executable, "-c", program, "midspan"]
        process = stack.enter_context(Process(command, {**os.environ, **environ}, pipes=True))
        assert process.popen.stdout is not None
        assert process.popen.stdout.readline()
        return process

    def seen(worker: Process) -> list[str]:
        view = hub({"worker": "ros2", "side": "ros2", "pid": worker.pid})
        around_it = around({"ros2": {"localhost_only": False}}, environ, hub=view)
        return [finding.seen for finding in every(ros2.check_environment(around_it))]

    with contextlib.ExitStack() as stack:
        older, server, younger = running(stack), running(stack, bind), running(stack)
        (finding,) = seen(older)
        assert f"at port {port} (process {server.pid}) was restarted after the ROS 2 side" in finding
        assert seen(younger) == ["domain 0"]


def test_a_shell_with_other_peers_or_security_than_the_daemons_is_reported() -> None:
    env = {**os.environ, "ROS_DOMAIN_ID": "0"}
    mine = {"ROS_STATIC_PEERS": "10.0.0.2", "ROS_SECURITY_ENABLE": "true"}
    with Process([sys.executable, "-c", "import sys; sys.stdin.read()", "midspan"], env, pipes=True) as worker:
        until(lambda: Path(f"/proc/{worker.pid}/cmdline").read_bytes().count(b"midspan"), "the worker runs")
        view = hub({"worker": "ros2", "side": "ros2", "pid": worker.pid})
        findings = every(ros2.check_environment(around({"ros2": {"localhost_only": False}}, mine, hub=view)))
    assert results(findings) == [Result.WARN, Result.FAIL]
    assert "ROS_STATIC_PEERS is 10.0.0.2 in this shell, not set for the daemon" in findings[0].seen
    assert "ROS_SECURITY_ENABLE is true for this shell, not for the daemon" in findings[1].seen


def test_a_shell_with_another_keystore_than_the_daemons_is_reported() -> None:
    secured = {"ROS_DOMAIN_ID": "0", "ROS_SECURITY_ENABLE": "true"}
    env = {**os.environ, **secured, "ROS_SECURITY_KEYSTORE": "/robot"}
    with Process([sys.executable, "-c", "import sys; sys.stdin.read()", "midspan"], env, pipes=True) as worker:
        until(lambda: Path(f"/proc/{worker.pid}/cmdline").read_bytes().count(b"midspan"), "the worker runs")
        view = hub({"worker": "ros2", "side": "ros2", "pid": worker.pid})

        def seen(keystore: str) -> str:
            mine = secured | {"ROS_SECURITY_KEYSTORE": keystore}
            return only(ros2.check_environment(around({}, mine, hub=view))).seen

        assert seen("/robot") == "domain 0"
        assert "ROS_SECURITY_KEYSTORE is /operator in this shell, /robot for the daemon" in seen("/operator")


@pytest.mark.parametrize(
    ("rmw", "result"),
    [
        ("", Result.OK),
        ("rmw_fastrtps_cpp", Result.OK),
        ("rmw_zenoh_cpp", Result.WARN),
        ("rmw_cyclonedds_cpp", Result.OK),
        ("rmw_connextdds", Result.WARN),
        ("rmw_typo_cpp", Result.FAIL),
    ],
)
def test_the_middleware_of_the_environment_is_checked(rmw: str, result: Result) -> None:
    assert only(ros2.check_rmw(around(environ={"RMW_IMPLEMENTATION": rmw}))).result is result


ON_CYCLONE = {"ros2": {"rmw": "rmw_cyclonedds_cpp"}}


def test_a_side_on_fast_dds_needs_no_check_of_cyclone_dds() -> None:
    assert only(ros2.check_cyclone(around())).result is Result.SKIP
    off = {"ros2": {"rmw": "rmw_cyclonedds_cpp", "enabled": False}}
    assert only(ros2.check_cyclone(around(off))).result is Result.SKIP


def test_a_missing_library_of_cyclone_dds_fails_the_check(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros2, "available", lambda _config: "librmw_cyclonedds_cpp.so is not in the ROS 2 in /opt; it")
    finding = only(ros2.check_cyclone(around(ON_CYCLONE)))
    assert finding.result is Result.FAIL
    assert "the ROS 2 side stays off: librmw_cyclonedds_cpp.so is not in the ROS 2 in /opt" in finding.seen


@pytest.mark.parametrize(
    ("foreign", "uncallable", "result", "words"),
    [
        (
            ["/arm", "/lamp"],
            ["/go", "/lamp"],
            Result.WARN,
            "services (/go, /lamp), actions and parameters of /arm, /lamp",
        ),
        (["/quiet"], [], Result.WARN, "services, actions and parameters of /quiet cannot be called"),
        ([], [], Result.OK, "no discovered node serves on another DDS"),
    ],
)
def test_nodes_whose_services_cannot_be_called_are_reported(
    foreign: list[str], uncallable: list[str], result: Result, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ros2, "available", lambda _config: "")
    report = {"nodes": [], "both": [], "foreign": foreign, "uncallable": uncallable}
    view = hub({"worker": "ros2", "side": "ros2", "cyclone": report})
    finding = only(ros2.check_cyclone(around(ON_CYCLONE, hub=view)))
    assert finding.result is result
    assert words in finding.seen
    assert result is Result.OK or "remove ros2.rmw" in finding.cure


@pytest.mark.parametrize("documents", [[], [{"worker": "ros2", "side": "ros2"}]], ids=["no worker", "no report yet"])
def test_without_a_report_only_the_library_is_checked(
    documents: list[dict[str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ros2, "available", lambda _config: "")
    finding = only(ros2.check_cyclone(around(ON_CYCLONE, hub=hub(*documents))))
    assert finding.result is Result.OK
    assert "the worker does not report" in finding.seen


@needs(ROS2)
def test_other_bridges_on_dds_are_reported(tmp_path: Path) -> None:
    domain = ros2_domain()
    config = Config.model_validate({"ros2": {"domain": domain}})
    env = worker_kinds({})["ros2"].child_environment(config)
    command = [sys.executable, "-c", OTHER_MIDSPAN, str(tmp_path), str(domain)]
    with (
        Process(command, env, pipes=True) as other,
        Peer(ROS2_PEER, ros2_python(), ros2_environment(), "ros_bridge") as peer,
    ):
        assert other.popen.stdout is not None
        prefix = other.popen.stdout.readline().strip()
        peer.advertise("/chatter", "std_msgs/String")

        def seen() -> bridges.DdsView | None:
            """Return the view if it is complete; on a busy machine, a check may fail or end too early."""
            try:
                view = bridges.check_dds(config, os.environ)
            except bridges.NetworkCheckError:
                return None
            return view if view.midspans and "/ros_bridge" in view.nodes else None

        view = until(seen, "both bridges are discovered")
    assert view is not None
    assert view.midspans == {prefix}
    finding = bridges.of_dds(around(), view)
    assert sorted(results(finding)) == [Result.FAIL, Result.WARN], finding
    ours = hub({"worker": "ros2", "side": "ros2", "network": prefix})
    assert results(bridges.of_dds(around(hub=ours), view)) == [Result.FAIL]
