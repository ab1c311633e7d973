"""``midspan teleop``: what keys mean, and a base driven from a real terminal."""

from __future__ import annotations

import os
import pty
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from bridge.cli.navigation.teleop import HOLD_SECONDS, Keys
from bridge.hub.session import Hub
from bridge.hub.wire.qos import Qos
from bridge.messages.json import to_json
from bridge.messages.registry import Registry
from tests.cli.conftest import Midspan, Outcome
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until

TWIST = "geometry_msgs/msg/Twist"


@pytest.mark.parametrize(
    ("key", "x", "y", "turn"),
    [
        ("i", 0.2, 0.0, 0.0), (",", -0.2, 0.0, 0.0), ("j", 0.0, 0.0, 0.5), ("l", 0.0, 0.0, -0.5), ("u", 0.2, 0.0, 0.5),
        (".", -0.2, 0.0, 0.5), ("J", 0.0, 0.2, 0.0), ("\x1b[A", 0.2, 0.0, 0.0), ("\x1b[C", 0.0, 0.0, -0.5),
        ("k", 0.0, 0.0, 0.0), (" ", 0.0, 0.0, 0.0), ("%", 0.0, 0.0, 0.0),
    ],
)  # fmt: skip
def test_keys(key: str, x: float, y: float, turn: float) -> None:
    keys = Keys(0.2, 0.5)
    keys.press("i", 1.0)
    keys.press(key, 1.1)
    assert keys.twist(1.2) == {"linear": {"x": x, "y": y}, "angular": {"z": turn}}


def test_released_key_stops_the_robot() -> None:
    keys = Keys(0.2, 0.5)
    keys.press("i", 1.0)
    assert keys.twist(1.0 + HOLD_SECONDS)["linear"]["x"] == 0.2
    assert keys.twist(1.01 + HOLD_SECONDS)["linear"]["x"] == 0.0


def test_faster_and_slower_within_bounds() -> None:
    keys = Keys(0.2, 0.5)
    keys.press("q", 1.0)
    assert (keys.speed, keys.turn) == pytest.approx((0.22, 0.55))
    for _ in range(100):
        keys.press("q", 1.0)
    assert (keys.speed, keys.turn) == (2.0, 3.0)
    keys.press("z", 1.0)
    assert keys.speed < 2.0


@pytest.fixture
def velocities(network: HubNetwork, registry: Registry) -> Iterator[list[Any]]:
    """Velocities on the hub: m/s forward, rad/s."""
    sent: list[Any] = []
    with_type = registry.ros2(TWIST).type_id

    def on_sample(sample: Any) -> None:
        message = to_json(registry, TWIST, sample.data())
        sent.append((message["linear"]["x"], message["angular"]["z"]))

    hub = Hub.open(network.settings("base"))
    subscription = hub.subscription("/cmd_vel", TWIST, with_type, Qos(), on_sample)
    yield sent
    subscription.close()
    hub.close()


def test_a_terminal_drives(midspan: Midspan, monkeypatch: pytest.MonkeyPatch, velocities: list[Any]) -> None:
    primary, secondary = pty.openpty()
    with os.fdopen(secondary) as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        done: list[Outcome] = []
        driving = threading.Thread(target=lambda: done.append(midspan("teleop")))
        driving.start()
        try:
            until(lambda: (os.write(primary, b"i"), (0.2, 0.0) in velocities)[1], "it drives")
            until(lambda: velocities[-1] == (0.0, 0.0), "it stops when no key is held")
            until(lambda: (os.write(primary, b"\x1b[D"), (0.0, 0.5) in velocities)[1], "it turns")
        finally:
            os.write(primary, b"x")
            driving.join(40)
        assert done[0].code == 0
        until(lambda: velocities[-1] == (0.0, 0.0), "it ends with zero")
        assert "+0.20" in done[0].out
    os.close(primary)


def test_no_terminal(midspan: Midspan) -> None:
    done = midspan("teleop")
    assert (done.code, "reads keys from a terminal" in done.err) == (1, True)


def test_teleop_without_terminal_support_fails_before_joining_the_hub(
    midspan: Midspan, monkeypatch: pytest.MonkeyPatch
) -> None:
    primary, secondary = pty.openpty()
    with os.fdopen(secondary) as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        monkeypatch.setattr("bridge.cli.navigation.teleop.AVAILABLE", False)
        monkeypatch.setattr("bridge.cli.navigation.teleop.open_client", lambda _: pytest.fail("it joins the hub"))
        done = midspan("teleop")
    os.close(primary)
    assert (done.code, "a terminal of POSIX only" in done.err) == (1, True)


def test_invalid_speeds_are_rejected(midspan: Midspan) -> None:
    assert "at most 2 m/s" in midspan("teleop", "--speed", "20").err
