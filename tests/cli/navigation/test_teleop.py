"""``midspan teleop``: the meaning of keys, and a base driven from a real terminal."""

from __future__ import annotations

import math
import os
import pty
import signal
import termios
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from bridge.cli.navigation import teleop
from bridge.cli.navigation.teleop import HOLD_SECONDS, Keys
from bridge.client.manual import ManualControl
from bridge.hub.control import MANUAL_DRIVING_HALTED
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Qos
from bridge.messages.json import to_json
from bridge.messages.registry import Registry
from tests.cli.conftest import Midspan, Outcome, alongside
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until

TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"


@pytest.mark.parametrize(
    ("key", "x", "y", "turn"),
    [
        ("i", 0.2, 0.0, 0.0), (",", -0.2, 0.0, 0.0), ("j", 0.0, 0.0, 0.5), ("l", 0.0, 0.0, -0.5), ("u", 0.2, 0.0, 0.5),
        (".", -0.2, 0.0, 0.5), ("J", 0.0, 0.2, 0.0), ("\x1b[A", 0.2, 0.0, 0.0), ("\x1b[C", 0.0, 0.0, -0.5),
        ("k", 0.0, 0.0, 0.0), (" ", 0.0, 0.0, 0.0), ("%", 0.0, 0.0, 0.0),
    ],
)  # fmt: skip
def test_each_key_sets_its_velocity(key: str, x: float, y: float, turn: float) -> None:
    keys = Keys(0.2, 0.5)
    keys.press(["i"], 1.0)
    keys.press([key], 1.1)
    assert keys.velocity(1.2) == (x, y, turn)


def test_released_key_stops_the_robot() -> None:
    keys = Keys(0.2, 0.5)
    keys.press(["i"], 1.0)
    assert keys.velocity(1.0 + HOLD_SECONDS)[0] == 0.2
    assert keys.velocity(1.01 + HOLD_SECONDS)[0] == 0.0


def test_keys_change_the_speed_within_bounds() -> None:
    keys = Keys(0.2, 0.5)
    keys.press(["q"], 1.0)
    assert (keys.speed, keys.turn) == pytest.approx((0.22, 0.55))
    for _ in range(100):
        keys.press(["q"], 1.0)
    assert (keys.speed, keys.turn) == (2.0, 3.0)
    keys.press(["z"], 1.0)
    assert keys.speed < 2.0


class Terminal:
    """Keys that arrive at a simulated time, read as `teleop` reads them."""

    def __init__(self) -> None:
        self.keys, self.now = Keys(0.2, 0.5), 100.0

    def read(self, *keys: str) -> float:
        """Read the keys of the next period; return the velocity forward."""
        self.now += 1.0 / teleop.RATE
        self.keys.press(keys, self.now)
        self.keys.tick(self.now)
        return self.keys.velocity(self.now)[0]

    def stay_silent(self, seconds: float) -> list[float]:
        """Read nothing for this time; return the velocities."""
        return [self.read() for _ in range(math.ceil(seconds * teleop.RATE))]

    def halt(self) -> None:
        """Halt while a key is held."""
        assert self.read("i") == 0.2
        self.keys.halt()


def test_a_key_must_be_released_after_a_halt() -> None:
    terminal = Terminal()
    terminal.halt()
    for _ in range(3):  # a keyboard repeats a held key
        assert terminal.read("i") == 0.0
        assert set(terminal.stay_silent(HOLD_SECONDS - 0.05)) == {0.0}
    assert terminal.read("i") == 0.0
    terminal.stay_silent(HOLD_SECONDS + 0.1)
    assert not terminal.keys.blocked
    assert terminal.read("i") == 0.2


@pytest.mark.parametrize("silent", [0.0, 0.5 * HOLD_SECONDS, HOLD_SECONDS])
def test_a_stall_after_a_halt_does_not_count_as_a_release(silent: float) -> None:
    """The keys that arrived meanwhile are read only afterwards."""
    terminal = Terminal()
    terminal.halt()
    terminal.stay_silent(silent)
    terminal.now += 5.0
    assert [terminal.read("i") for _ in range(20)] == [0.0] * 20
    terminal.stay_silent(HOLD_SECONDS + 0.1)
    assert terminal.read("i") == 0.2


def test_a_stall_just_before_the_keys_of_that_time_are_read_is_no_release() -> None:
    terminal = Terminal()
    terminal.halt()
    terminal.now += 5.0
    assert terminal.read() == 0.0
    assert [terminal.read("i") for _ in range(20)] == [0.0] * 20


def test_keys_that_a_network_delayed_after_a_halt_are_no_new_press() -> None:
    """A terminal over a network may be silent for a moment although a key is held; then all of its keys arrive."""
    terminal = Terminal()
    terminal.halt()
    terminal.stay_silent(3.0)
    assert terminal.read(*"iiiiii") == 0.0
    assert terminal.read("i") == 0.0
    terminal.stay_silent(HOLD_SECONDS + 0.1)
    assert terminal.read("i") == 0.2
    assert terminal.read("i", "i") == 0.2, "later keys may arrive together"


def test_keys_of_a_stall_do_not_drive() -> None:
    """The key may have been released long ago; a key that is still held repeats itself."""
    terminal = Terminal()
    assert terminal.read("i") == 0.2
    terminal.now += 5.0
    assert terminal.read(*"iiiiii") == 0.0
    assert terminal.read("i") == 0.2


def test_a_stop_key_has_an_effect_after_a_stall() -> None:
    terminal = Terminal()
    assert terminal.read("i") == 0.2
    terminal.now += 5.0
    terminal.read("i", "x", "i")
    assert terminal.keys.ended


class Base:
    """A base on the hub that subscribes to one type; ``sent``: the velocities that it received (m/s forward, rad/s)."""

    def __init__(self, network: HubNetwork, registry: Registry, type_name: str) -> None:
        self.sent: list[tuple[float, float]] = []
        self.messages: list[Any] = []
        self._registry, self._type_name = registry, type_name
        self._hub = Hub.open(network.settings("base"))
        self._hub.subscription("/cmd_vel", type_name, registry.ros2(type_name).type_id, Qos(), self._on_sample)

    def _on_sample(self, sample: Any) -> None:
        message = to_json(self._registry, self._type_name, sample.data())
        twist = message.get("twist", message)
        self.messages.append(message)
        self.sent.append((twist["linear"]["x"], twist["angular"]["z"]))

    def close(self) -> None:
        self._hub.close()


class Driver:
    """``midspan teleop`` in a terminal, whose keys the test presses."""

    def __init__(self, midspan: Midspan, monkeypatch: pytest.MonkeyPatch) -> None:
        self._midspan, self._monkeypatch = midspan, monkeypatch
        self.done: list[Outcome] = []

    @contextmanager
    def drive(self, *arguments: str) -> Iterator[None]:
        self._primary, secondary = pty.openpty()
        with os.fdopen(secondary) as terminal:
            self._monkeypatch.setattr("sys.stdin", terminal)
            driving = threading.Thread(target=lambda: self.done.append(self._midspan("teleop", *arguments)))
            driving.start()
            try:
                yield
            finally:
                self.press(b"x")
                driving.join(40)
        os.close(self._primary)

    def press(self, key: bytes) -> None:
        os.write(self._primary, key)


@pytest.fixture
def driver(midspan: Midspan, monkeypatch: pytest.MonkeyPatch) -> Driver:
    return Driver(midspan, monkeypatch)


@pytest.mark.parametrize("type_name", [TWIST, TWIST_STAMPED])
def test_a_terminal_drives(
    driver: Driver, network: HubNetwork, registry: Registry, closing: list[Any], type_name: str
) -> None:
    base = Base(network, registry, type_name)
    closing.append(base)
    with driver.drive():
        until(lambda: (driver.press(b"i"), (0.2, 0.0) in base.sent)[1], "the base drives")
        until(lambda: base.sent[-5:] == [(0.0, 0.0)] * 5, "zero is repeated when no key is held")
        until(lambda: (driver.press(b"\x1b[D"), (0.0, 0.5) in base.sent)[1], "the base turns")
    (done,) = driver.done
    assert done.code == 0
    until(lambda: base.sent[-5:] == [(0.0, 0.0)] * 5, "zero is repeated at the end")
    assert "+0.20" in done.out
    assert f"/cmd_vel ({type_name})" in done.out
    if type_name == TWIST_STAMPED:
        header = base.messages[-1]["header"]
        assert (header["frame_id"], abs(header["stamp"]["sec"] - time.time()) < 60) == ("base_link", True)


def test_teleop_follows_a_base_that_changes_its_form(
    driver: Driver, network: HubNetwork, registry: Registry, closing: list[Any]
) -> None:
    old = Base(network, registry, TWIST)
    closing.append(old)
    with driver.drive():
        until(lambda: (driver.press(b"i"), (0.2, 0.0) in old.sent)[1], "the base drives")
        new = Base(network, registry, TWIST_STAMPED)
        closing.append(new)
        old.close()
        until(lambda: (driver.press(b"i"), (0.2, 0.0) in new.sent)[1], "velocities continue in the other type")
        until(lambda: new.sent[-1] == (0.0, 0.0), "the base stops when no key is held")


def test_teleop_does_not_drive_against_another_person(
    driver: Driver, network: HubNetwork, registry: Registry, closing: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    hold = 2.0  # on a busy machine, keys that are held may arrive late
    monkeypatch.setattr(teleop, "HOLD_SECONDS", hold)
    base, publish = Base(network, registry, TWIST), teleop.Driver.publish
    closing.append(base)
    shown: list[str] = []
    monkeypatch.setattr(teleop.Driver, "publish", lambda this: (shown.append(publish(this)), shown[-1])[1])
    with Hub.open(network.settings("web")) as hub:
        other = ManualControl(hub, "/cmd_vel")
        other.begin("anna (web)")
        with driver.drive():
            until(lambda: "anna (web) drives manually" in shown, "teleop shows who drives")
            refused = "anna (web) drives manually: not driving"
            until(lambda: (driver.press(b"i"), refused in shown)[1], "teleop shows that it does not drive")
            assert (0.2, 0.0) not in base.sent
            assert other.rival() == ""
            other.end()
            release = "stopped: release the key first"
            until(lambda: (driver.press(b"i"), release in shown or base.sent)[1], "control is free")
            assert (0.2, 0.0) not in base.sent, "a key that was held while another person drove does not drive"
            until(
                lambda: (driver.press(b"i"), (0.2, 0.0) in base.sent)[1],
                "teleop drives once the key is pressed again",
                every=hold + 0.2,
            )
            refused = "midspan teleop"
            until(lambda: (driver.press(b"i"), other.rival().startswith(refused))[1], "the other is refused meanwhile")


def test_a_halt_on_the_hub_ends_driving(
    driver: Driver, network: HubNetwork, registry: Registry, closing: list[Any]
) -> None:
    base = Base(network, registry, TWIST)
    closing.append(base)
    with Hub.open(network.settings("halting")) as hub, driver.drive():
        until(lambda: (driver.press(b"i"), (0.2, 0.0) in base.sent)[1], "the base drives")
        begin = len(base.sent)
        assert MANUAL_DRIVING_HALTED in [answer.value for answer in hub.ask("halt", {}, timeout=20.0)]
        until(lambda: (driver.press(b"i"), (0.0, 0.0) in base.sent[begin:])[1], "the base stands with the key held")


def test_a_key_that_is_held_during_a_stall_after_a_halt_does_not_drive(
    driver: Driver, network: HubNetwork, registry: Registry, closing: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The terminal is so slow that the program waits in its output."""
    hold = 2.0  # on a busy machine, keys that are held may arrive late
    monkeypatch.setattr(teleop, "HOLD_SECONDS", hold)
    base, publish = Base(network, registry, TWIST), teleop.Driver.publish
    closing.append(base)
    shown: list[str] = []
    resumed = threading.Event()
    resumed.set()

    def publish_slowly(this: teleop.Driver) -> str:
        shown.append(publish(this))
        resumed.wait(40)
        return shown[-1]

    monkeypatch.setattr(teleop.Driver, "publish", publish_slowly)
    with Hub.open(network.settings("halting")) as hub, driver.drive():
        until(lambda: (driver.press(b"i"), (0.2, 0.0) in base.sent)[1], "the base drives")
        resumed.clear()
        hub.ask("halt", {}, timeout=20.0)
        stall = time.monotonic() + 2 * hold
        until(lambda: (driver.press(b"i"), time.monotonic() > stall)[1], "the program stalls while the key is held")
        begin, shows = len(base.sent), len(shown)
        resumed.set()
        until(lambda: (driver.press(b"i"), len(shown) > shows + 20)[1], "the program continues", every=0.05)
        until(lambda: (0.0, 0.0) in base.sent[begin:], "the base stands")
        assert (0.2, 0.0) not in base.sent[begin:]


def test_teleop_publishes_the_chosen_form(
    driver: Driver, network: HubNetwork, registry: Registry, closing: list[Any]
) -> None:
    bases = {name: Base(network, registry, name) for name in (TWIST, TWIST_STAMPED)}
    closing.extend(bases.values())
    with driver.drive("--stamped", "true"):
        until(lambda: (driver.press(b"i"), (0.2, 0.0) in bases[TWIST_STAMPED].sent)[1], "the stamped base drives")
    assert bases[TWIST].sent == []


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGINT, 0)])
def test_a_signal_ends_the_velocity_and_restores_the_terminal(
    midspan: Midspan, network: HubNetwork, registry: Registry, closing: list[Any], monkeypatch: pytest.MonkeyPatch,
    number: signal.Signals, code: int,
) -> None:  # fmt: skip
    base = Base(network, registry, TWIST)
    closing.append(base)
    primary, secondary = pty.openpty()

    def drive_and_signal() -> None:
        until(lambda: (os.write(primary, b"i"), (0.2, 0.0) in base.sent)[1], "the base drives")
        os.kill(os.getpid(), number)

    with os.fdopen(secondary) as terminal:
        before = termios.tcgetattr(terminal)
        monkeypatch.setattr("sys.stdin", terminal)
        with alongside(drive_and_signal):
            done = midspan("teleop")
        assert termios.tcgetattr(terminal) == before
    os.close(primary)
    assert done.code == code
    until(lambda: base.sent[-1] == (0.0, 0.0), "a zero velocity is sent at the end")


def test_teleop_without_a_terminal_is_refused(midspan: Midspan) -> None:
    done = midspan("teleop")
    assert (done.code, "reads keys only from a POSIX terminal" in done.err) == (1, True)


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
    assert (done.code, "only from a POSIX terminal" in done.err) == (1, True)


def test_invalid_speeds_are_rejected(midspan: Midspan) -> None:
    assert "at most 2 m/s" in midspan("teleop", "--speed", "20").err
