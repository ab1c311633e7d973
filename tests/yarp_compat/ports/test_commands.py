"""Velocity commands to readers that are slow or out of reach: they neither wait nor arrive late without a stop."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest

from tests.support.wait import until
from tests.yarp_compat.ports.conftest import MakePort
from tests.yarp_compat.ports.test_buffering import Slow
from yarp_compat.ports.commands import CommandWriter
from yarp_compat.ports.naming import LocalNaming
from yarp_compat.ports.output import Output
from yarp_compat.ports.port import PortCore

STOP = b"stop"
LIFESPAN = 0.1


class Robot:
    """A robot's driver that reads on demand, and the commander's port."""

    def __init__(self, core: PortCore, driver: Slow, carrier: str, lifespan: float = LIFESPAN) -> None:
        core.add_output(f"{carrier}://slow")
        (self.output,) = core.connections.outputs
        self.driver, self.writer = driver, CommandWriter(core, lifespan)
        self._earlier = CommandWriter(core, 40.0)

    @property
    def dropped(self) -> int:
        return self.output.counters.dropped["late"]

    def until_stop_waits(self) -> None:
        assert isinstance(self.output, Output)
        until(lambda: self.output._pending, "the stop waits for the acknowledgment")

    def until_out_of_reach(self) -> int:
        """Send commands until the driver's system accepts no more; return their number.

        None of them is late: another writer sends them, because on a busy machine this may take longer than a lifespan.
        """
        assert isinstance(self.output, Output)
        count = 0
        while self.output.sent_bytes - self.output.acknowledged < 200_000:  # more than the driver's system accepts
            count += self._earlier.write(b"%d" % count + bytes(10_000), STOP)
            assert count < 1000
        return count


@pytest.fixture
def slow(naming: LocalNaming) -> Iterator[Slow]:
    peer = Slow()
    naming.register("/slow", *peer.server.getsockname())
    yield peer
    peer.close()


@pytest.fixture
def core(make_port: MakePort) -> PortCore:
    return make_port("/w")


def test_a_stop_follows_a_command_that_is_acknowledged_late(core: PortCore, slow: Slow) -> None:
    robot = Robot(core, slow, "tcp")
    assert [robot.writer.write(b"%d" % number, STOP) for number in range(5)] == [1, 0, 0, 0, 0]
    robot.until_stop_waits()
    assert robot.writer.write(b"5", STOP) == 0
    assert robot.dropped == 5
    assert slow.read() == b"0"
    slow.acknowledge()
    assert slow.read() == STOP
    slow.acknowledge()
    until(lambda: robot.writer.write(b"6", STOP), "commands continue")
    assert slow.read() == b"6"


def test_a_stop_waits_for_a_busy_driver(core: PortCore, slow: Slow) -> None:
    robot = Robot(core, slow, "tcp", lifespan=40.0)
    robot.writer.write(b"1", STOP)
    assert robot.writer.write(b"2", STOP) == 0
    assert robot.writer.write(STOP, STOP) == 1
    assert slow.read() == b"1"
    slow.acknowledge()
    assert slow.read() == STOP


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux shows what is unacknowledged")
def test_a_stop_follows_the_commands_that_a_network_delays(core: PortCore, slow: Slow) -> None:
    robot = Robot(core, slow, "fast_tcp")
    sent = robot.until_out_of_reach()
    until(lambda: robot.writer.write(b"late", STOP) == 0, "a command is late")
    dropped = robot.dropped
    assert [robot.writer.write(b"late", STOP) for _ in range(5)] == [0] * 5
    assert robot.dropped == dropped + 5
    received = []
    while (payload := slow.read()) != STOP:
        received.append(payload.rstrip(b"\0"))
    assert received[:sent] == [b"%d" % number for number in range(sent)]
    until(lambda: robot.writer.write(b"on time", STOP), "commands continue")
    assert slow.read() == b"on time"


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux shows what is unacknowledged")
def test_the_commands_of_a_silent_commander_are_followed_by_a_stop(core: PortCore, slow: Slow) -> None:
    robot = Robot(core, slow, "fast_tcp")
    robot.until_out_of_reach()
    sent = robot.output.counters.sent
    assert robot.writer.write(b"last", STOP) == 1
    until(lambda: robot.output.counters.sent == sent + 2, "a stop is sent after the last command")
    while slow.read() != STOP:
        pass


def test_all_commands_reach_a_driver_that_reads(make_port: MakePort) -> None:
    received: list[bytes] = []
    driver = make_port("/driver", lambda message: received.append(bytes(message.payload)))
    core = make_port("/w")
    core.add_output("fast_tcp:/" + driver.name)
    writer = CommandWriter(core, 40.0)
    commands = [b"%d" % number for number in range(200)]
    assert [writer.write(command, STOP) for command in commands] == [1] * 200
    until(lambda: received == commands, "all commands arrive")


def test_a_type_without_a_stop_is_dropped_while_the_driver_is_busy(core: PortCore, slow: Slow) -> None:
    robot = Robot(core, slow, "tcp")
    assert [robot.writer.write(b"joy", None) for _ in range(3)] == [1, 0, 0]
    core.remove_output("/slow")
    assert robot.writer.write(b"joy", None) == 0
