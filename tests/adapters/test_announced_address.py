"""The address that a side's worker has announced, on a machine that loses it."""

from __future__ import annotations

import pytest

from bridge.adapters import announced_address
from bridge.adapters.announced_address import AnnouncedAddress

FOREIGN = "203.0.113.7"  # of TEST-NET-3 (RFC 5737), which no machine has


@pytest.mark.parametrize(
    ("host", "lost"),
    [
        (FOREIGN, True),
        ("2001:db8::7", True),
        ("127.0.0.1", False),
        ("fe80::1", False),  # belongs to a machine only together with an interface
        ("robot1", False),
        ("", False),
    ],
)
def test_only_an_ip_address_can_be_lost(host: str, lost: bool) -> None:
    address = AnnouncedAddress("yarp", "YARP ports are", "yarp.address, yarp.ip")
    address.check(host)
    assert (address.trouble != "") == lost


def test_the_loss_and_the_return_are_logged_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    present = [True, False, False, True, True]
    monkeypatch.setattr(announced_address, "has_address", lambda _host: present.pop(0))
    address = AnnouncedAddress("ros1", "ROS 1 node is", "ros1.ip, ros1.hostname")
    troubles = []
    while present:
        address.check(FOREIGN)
        troubles.append(address.trouble)
    text = (
        f"this machine does not have the address {FOREIGN} now, under which its ROS 1 node is registered: no program"
        " can connect; connect this machine to that network, or restart the daemon with its current address"
        " (ros1.ip, ros1.hostname)"
    )
    assert troubles == ["", text, text, "", ""]
    back = "ros1: this machine has the address again under which its ROS 1 node is registered"
    # threads of earlier tests may still log
    own = [record.getMessage() for record in caplog.records if record.name == announced_address.__name__]
    assert own == [f"ros1: {text}", back]
