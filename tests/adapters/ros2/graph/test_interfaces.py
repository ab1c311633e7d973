"""New network addresses: which of them count, each reported once."""

from __future__ import annotations

import contextlib
import errno
import socket
from types import SimpleNamespace

import psutil
import pytest

from bridge.adapters.ros2.graph.interfaces import InterfaceWatch, ipv4_addresses
from bridge.concurrency import DelayedCalls

WIRED, WIFI, VPN = ("eth0", "10.0.0.2"), ("wlan0", "192.168.1.7"), ("tun0", "10.8.0.3")
TEXT = "this machine has a new address that the ROS 2 side does not use: "


class Calls(DelayedCalls):
    """Runs delayed calls on the test's command; their errors only end them, as in the base class."""

    def __init__(self) -> None:
        super().__init__("test")
        self.waiting: list[object] = []

    def after(self, seconds: float, call: object, *, once: bool = False) -> None:  # noqa: ARG002
        self.waiting.append(call)

    def pass_period(self) -> None:
        calls, self.waiting = self.waiting, []
        for call in calls:
            with contextlib.suppress(OSError):
                call()  # type: ignore[operator]


class Machine:
    """A machine with changing addresses, and the reports of the watch."""

    def __init__(self, *addresses: tuple[str, str]) -> None:
        self.addresses = set(addresses)
        self.reported: list[str] = []
        self.calls = Calls()
        known = frozenset(addresses)
        self.errors: list[OSError] = []
        self.watch = InterfaceWatch(self.reported.append, self.calls, known, self._read)

    def _read(self) -> frozenset[tuple[str, str]]:
        if self.errors:
            raise self.errors.pop()
        return frozenset(self.addresses)

    def checks(self, count: int) -> None:
        for _ in range(count):
            self.calls.pass_period()


def test_a_new_address_is_reported_once() -> None:
    machine = Machine(WIRED)
    machine.checks(3)
    machine.addresses |= {WIFI}
    machine.checks(1)
    assert (machine.reported, machine.watch.text) == ([], f"{TEXT}192.168.1.7 on wlan0")
    machine.addresses |= {VPN}  # a machine that joins a network often gets several addresses in turn
    machine.checks(1)
    assert machine.reported == []
    machine.checks(5)
    assert machine.reported == [f"{TEXT}10.8.0.3 on tun0, 192.168.1.7 on wlan0"]


def test_the_text_follows_the_addresses() -> None:
    """With a profile, the participant stays."""
    machine = Machine(WIRED)
    machine.addresses |= {WIFI}
    machine.checks(2)
    machine.addresses = {WIRED}
    machine.checks(1)
    assert machine.watch.text == "", "the address has disappeared"
    machine.addresses |= {VPN}
    machine.checks(3)
    machine.addresses |= {WIFI}
    machine.checks(3)
    assert machine.watch.text == f"{TEXT}10.8.0.3 on tun0, 192.168.1.7 on wlan0"
    assert machine.reported == [f"{TEXT}192.168.1.7 on wlan0", f"{TEXT}10.8.0.3 on tun0"]


def test_addresses_are_read_again_after_an_error() -> None:
    machine = Machine(WIRED)
    machine.errors = [OSError(errno.EMFILE, "Too many open files")]
    machine.checks(1)
    machine.addresses |= {WIFI}
    machine.checks(2)
    assert machine.reported == [f"{TEXT}192.168.1.7 on wlan0"]


def test_an_address_that_disappears_and_returns_is_not_new() -> None:
    machine = Machine(WIRED, WIFI)
    for addresses in ({WIRED}, {WIRED, WIFI}, set(), {WIFI}):
        machine.addresses = addresses
        machine.checks(3)
    machine.addresses = {WIRED, VPN}
    machine.checks(1)
    machine.addresses = {WIRED}
    machine.checks(3)
    assert (machine.reported, machine.watch.text) == ([], "")


def test_another_address_on_the_same_interface_is_new() -> None:
    machine = Machine(WIFI)
    machine.addresses = {("wlan0", "192.168.1.99")}
    machine.checks(2)
    assert machine.reported == [f"{TEXT}192.168.1.99 on wlan0"]


def test_loopback_and_interfaces_that_are_down_do_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    result = {
        "lo": ["127.0.0.1"], "eth0": ["10.0.0.2", "fe80::1"], "down0": ["10.1.0.2"], "gone0": ["10.2.0.2"],
    }  # fmt: skip

    def entries(addresses: list[str]) -> list[SimpleNamespace]:
        families = [socket.AF_INET6 if ":" in address else socket.AF_INET for address in addresses]
        return [SimpleNamespace(family=f, address=a) for f, a in zip(families, addresses, strict=True)]

    states = {"lo": True, "eth0": True, "down0": False}
    monkeypatch.setattr(psutil, "net_if_addrs", lambda: {name: entries(result[name]) for name in result})
    monkeypatch.setattr(psutil, "net_if_stats", lambda: {n: SimpleNamespace(isup=up) for n, up in states.items()})
    assert ipv4_addresses() == {("eth0", "10.0.0.2")}
