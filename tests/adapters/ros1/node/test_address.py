"""The node's address follows the rules of the real rosgraph."""

from __future__ import annotations

import json
import logging
import socket
import subprocess

import pytest

from bridge.adapters.ros1.node import address as address_module
from bridge.adapters.ros1.node.address import NodeAddress
from tests.peers.ros1.network import ROS1_PYTHON, needs_ros1, ros1_environment

ENVIRONMENTS: list[dict[str, str]] = [
    {},
    {"ROS_IP": "127.0.0.1"},
    {"ROS_IP": "127.5.0.1"},
    {"ROS_IP": "10.0.0.7"},
    {"ROS_IP": ""},
    {"ROS_HOSTNAME": "robot"},
    {"ROS_HOSTNAME": "localhost"},
    {"ROS_HOSTNAME": "robot", "ROS_IP": "127.0.0.1"},
    {"ROS_HOSTNAME": "", "ROS_IP": "10.0.0.7"},
    {"ROS_IPV6": "on"},
    {"ROS_IPV6": "off", "ROS_IP": "10.0.0.7"},
    {"ROS_IPV6": "on", "ROS_IP": "::1"},
    {"ROS_IPV6": "on", "ROS_HOSTNAME": "localhost"},
    {"ROS_IPV6": "on", "ROS_HOSTNAME": "robot"},
]

ROSGRAPH = """
import json, os, sys
from rosgraph import network
results = []
for environ in json.load(sys.stdin):
    for name in ("ROS_IP", "ROS_HOSTNAME", "ROS_IPV6"):
        os.environ.pop(name, None)
    os.environ.update(environ)
    results.append([network.get_host_name(), network.get_bind_address(), network.use_ipv6()])
print(json.dumps(results))
"""


@needs_ros1
def test_addresses_follow_the_rules_of_rosgraph() -> None:
    done = subprocess.run(
        [ROS1_PYTHON, "-c", ROSGRAPH], env=ros1_environment(), input=json.dumps(ENVIRONMENTS), text=True,
        capture_output=True, check=True,
    )  # fmt: skip
    addresses = [NodeAddress.of(environ) for environ in ENVIRONMENTS]
    assert [[a.host, a.bind, a.ipv6] for a in addresses] == json.loads(done.stdout)


@pytest.mark.parametrize("name", ["localhost", "127.0.1.1", ""])
def test_a_machine_with_a_loopback_name_announces_an_interface(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    entry = lambda family, address: type("Entry", (), {"family": family, "address": address})  # noqa: E731
    interfaces = {
        "lo": [entry(socket.AF_INET, "127.0.0.1"), entry(socket.AF_INET6, "::1")],
        "eth0": [
            entry(socket.AF_INET6, "fe80::1%eth0"), entry(socket.AF_INET, "192.0.2.5"),
            entry(socket.AF_INET6, "2001:db8::5"),
        ],
    }  # fmt: skip
    monkeypatch.setattr("socket.gethostname", lambda: name)
    monkeypatch.setattr("psutil.net_if_addrs", lambda: interfaces)
    assert NodeAddress.of({}).host == "192.0.2.5"
    assert NodeAddress.of({"ROS_IPV6": "on"}).host == "2001:db8::5"
    del interfaces["eth0"]
    assert NodeAddress.of({}).host == "127.0.0.1"


def test_an_ipv6_address_is_in_brackets_in_a_uri() -> None:
    assert NodeAddress.of({"ROS_IPV6": "on", "ROS_IP": "::1"}).in_uri == "[::1]"
    assert NodeAddress.of({"ROS_HOSTNAME": "robot"}).in_uri == "robot"


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("ROS_HOSTNAME", "http://robot", "protocol"),
        ("ROS_HOSTNAME", "robot:11311", "port"),
        ("ROS_IP", "http://10.0.0.7", "protocol"),
        ("ROS_IP", "10.0.0.7:1234", "port"),
        ("ROS_IP", "robot", "must be an IPv4 or IPv6 address"),
    ],
)
def test_an_unusable_value_is_logged(caplog: pytest.LogCaptureFixture, name: str, value: str, reason: str) -> None:
    with caplog.at_level(logging.WARNING):
        NodeAddress.of({name: value})
    # threads of earlier tests may still log
    (record,) = (record for record in caplog.records if record.name == address_module.__name__)
    assert name in record.getMessage()
    assert reason in record.getMessage()


def reachable(listener: socket.socket, host: str) -> bool:
    with socket.create_connection((host, listener.getsockname()[1]), 20):
        sock, _ = listener.accept()
        sock.close()
        return True


@pytest.mark.parametrize("environ", [{"ROS_IP": "127.0.0.1"}, {"ROS_IPV6": "on", "ROS_IP": "::1"}])
def test_a_node_listens_on_the_announced_address(environ: dict[str, str]) -> None:
    address = NodeAddress.of(environ)
    with address.listen() as listener:
        assert reachable(listener, address.host)


def test_on_all_interfaces_ipv6_accepts_both_protocols() -> None:
    with NodeAddress.of({"ROS_IPV6": "on", "ROS_HOSTNAME": "robot"}).listen() as listener:
        assert reachable(listener, "127.0.0.1")
        assert reachable(listener, "::1")
