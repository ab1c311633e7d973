"""Checks of YARP, against a name server."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from bridge.doctor.check import Finding, Result
from bridge.doctor.checks import yarp
from tests.doctor.parts import around, hub, only
from tests.peers.yarp.programs import Names
from tests.support.ports import free_port


@pytest.fixture
def names() -> Iterator[Names]:
    name_servers = Names()
    yield name_servers
    name_servers.stop()


def test_an_unreachable_name_server_is_reported(names: Names) -> None:
    reachable = around({"yarp": {"address": names.endpoint, "nameserver": "site"}})
    assert only(yarp.check_name_server(reachable)).result is Result.OK
    address = f"127.0.0.1:{free_port()}"
    site = only(yarp.check_name_server(around({"yarp": {"address": address, "nameserver": "site"}})))
    assert (site.result, "start yarpserver" in site.cure) == (Result.FAIL, True)
    assert only(yarp.check_name_server(around({"yarp": {"address": address}}))).result is Result.WARN
    assert only(yarp.check_name_server(around({"yarp": {"enabled": False}}))).result is Result.SKIP


def test_a_shell_with_another_name_server_than_the_daemons_is_reported(names: Names, tmp_path: Path) -> None:
    config = {"yarp": {"address": names.endpoint}}
    environ = {"YARP_CONFIG_HOME": str(tmp_path)}
    none = only(yarp.check_environment(around(config, environ)))
    assert (none.result, str(tmp_path / "yarp.conf") in none.cure) == (Result.WARN, True)
    (tmp_path / "yarp.conf").write_text("127.0.0.1 1 yarp\n")
    assert "has 127.0.0.1:1" in only(yarp.check_environment(around(config, environ))).seen
    (tmp_path / "yarp.conf").write_text(f"{names.address.host} {names.address.port} yarp\n")
    assert only(yarp.check_environment(around(config, environ))).result is Result.OK
    (tmp_path / "yarp.conf").write_text("nonsense\n")
    assert only(yarp.check_environment(around(config, environ))).result is Result.FAIL


def report_on(*peers: dict[str, str]) -> list[Finding]:
    module = {"module": True, "worker": "gateway", "ports": [{"port": "/nav/rpc", "peers": list(peers)}]}
    findings = yarp.check_releases(around(hub=hub(module)))
    return [findings] if isinstance(findings, Finding) else list(findings)


def test_clients_of_an_unknown_release_are_a_warning() -> None:
    assert only(yarp.check_releases(around())).result is Result.SKIP
    known = {"port": "/new/rpc", "generation": "4.0", "generation_why": "it asked"}
    guess = {"port": "/old/rpc", "generation": "3.12", "generation_why": "a guess", "generation_cure": "set it"}
    (ok,) = report_on(known)
    assert (ok.result, ok.seen) == (Result.OK, "/new/rpc: 4.0 (it asked)")
    warning, ok = report_on(known, guess)
    assert (warning.result, ok.result) == (Result.WARN, Result.OK)
    assert "/old/rpc at /nav/rpc is unknown (a guess)" in warning.seen
    assert warning.cure == "set it"
    several = report_on(*({**known, "port": f"/n{number}/rpc"} for number in range(12)))
    assert [(finding.result, finding.seen[-12:]) for finding in several] == [(Result.OK, ", and 2 more")]
