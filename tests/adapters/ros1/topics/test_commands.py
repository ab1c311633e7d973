"""Connections to subscribers of velocity commands: commands that the network delays are neither queued nor executed."""

from __future__ import annotations

import socket
import struct
import sys
from collections.abc import Iterator

import pytest

from bridge.adapters.ros1.topics.commands import CommandConnection
from bridge.messages.velocities import stop_after
from tests.support.wait import until
from yarp_compat.in_flight import unacknowledged

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux shows what is unacknowledged")

TWIST = "geometry_msgs/Twist"
LIFESPAN, LONG = 0.1, 40.0
"""Seconds: commands have the longer time until a test waits until they are late, because it may be suspended."""


def velocity(number: float) -> bytes:
    return struct.pack("<6d", number, 0, 0, 0, 0, 0)


class Driver:
    """A subscriber whose system accepts a few commands, while the program reads none until `read`."""

    def __init__(self, type_name: str = TWIST, lifespan: float = LONG) -> None:
        with socket.socket() as listener:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
            listener.bind(("127.0.0.1", 0))
            listener.listen()
            ours = socket.create_connection(listener.getsockname())
            self.sock, _ = listener.accept()
        self.sock.settimeout(40)
        self.ended: list[object] = []
        self.outlet = CommandConnection(ours, "test-commands", "/driver", self.ended.append, type_name, lifespan)
        self.sent = 0

    def send(self) -> None:
        self.sent += 1
        assert self.outlet.send(velocity(self.sent), "a", 1)

    def fill(self) -> None:
        """Send more commands than the subscriber's system accepts."""
        for _ in range(100):
            self.send()
        assert self.outlet.dropped == 0

    def until_late(self) -> None:
        self.outlet._lifespan = LIFESPAN
        until(lambda: not self.outlet.check() and self.outlet._in_flight, "a command is late")

    def until_acknowledged(self) -> None:
        until(lambda: unacknowledged(self.outlet._sock) == 0, "all is acknowledged")

    def read(self) -> float:
        data = b""
        while len(data) < 52:
            part = self.sock.recv(52 - len(data))
            assert part, "the connection was closed"
            data += part
        return float(struct.unpack_from("<d", data, 4)[0])

    def is_silent(self) -> bool:
        self.sock.settimeout(0.05)
        try:
            return not self.sock.recv(1)
        except TimeoutError:
            return True

    def close(self) -> None:
        self.outlet.close()
        self.sock.close()


@pytest.fixture
def driver() -> Iterator[Driver]:
    driver = Driver()
    yield driver
    driver.close()


def test_acknowledged_commands_are_all_sent(driver: Driver) -> None:
    for number in range(1, 200):
        driver.send()
        assert driver.read() == number
    assert driver.outlet.dropped == 0
    driver.until_acknowledged()
    assert driver.outlet.check() is False


def test_after_a_late_command_only_a_stop_is_sent(driver: Driver) -> None:
    driver.fill()
    driver.until_late()
    last = driver.sent
    for _ in range(100):
        driver.send()
    assert driver.outlet.dropped == 100
    assert [driver.read() for _ in range(last + 1)] == [*range(1, last + 1), 0.0]
    driver.until_acknowledged()
    driver.send()
    assert driver.read() == driver.sent, "commands continue"


def test_a_silent_commanders_late_command_is_followed_by_one_stop(driver: Driver) -> None:
    driver.fill()
    assert driver.outlet.check() is True, "unacknowledged, but not late"
    driver.until_late()
    driver.until_late()
    assert [driver.read() for _ in range(driver.sent + 1)][-2:] == [driver.sent, 0.0]
    assert driver.is_silent()


def test_a_command_does_not_wait_for_one_that_is_sent_in_part() -> None:
    driver = Driver("sensor_msgs/Joy")
    assert driver.outlet.send(bytes(16_000_000), "a", 1), "more than the buffers of both systems hold"
    assert driver.outlet.busy
    driver.send()
    assert driver.outlet.dropped == 1
    assert driver.outlet.waiting == 0
    driver.close()


def test_a_type_without_a_velocity_gets_no_stop() -> None:
    driver = Driver("sensor_msgs/Joy")
    driver.fill()
    driver.until_late()
    last = driver.sent
    driver.send()
    assert [driver.read() for _ in range(last)][-1] == last
    assert driver.is_silent()
    driver.close()


def test_the_stop_of_a_stamped_velocity_keeps_the_header() -> None:
    header = struct.pack("<III", 7, 100, 0) + struct.pack("<I4s", 4, b"base")
    assert stop_after("geometry_msgs/TwistStamped", header + velocity(1)) == header + bytes(48)


def test_a_closed_connection_is_not_late(driver: Driver) -> None:
    driver.fill()
    driver.outlet.close()
    assert driver.outlet.check() is False
    assert driver.outlet.send(velocity(1), "a", 1) is False
