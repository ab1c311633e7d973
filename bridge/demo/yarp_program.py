"""A YARP program of the demo: listens to ports, drives by short Bottles, and once by lines of text on a bare socket.

Usage: ``python -m bridge.demo.yarp_program NAME_SERVER_PORT``.
"""

from __future__ import annotations

import contextlib
import math
import socket
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from bridge.demo import topics, wording
from bridge.demo.report import Voice, serve
from yarp_compat.dev.laserscan import LaserScan2D
from yarp_compat.dev.odometry import OdometryData
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.naming.errors import NamingError
from yarp_compat.ports.message import Message
from yarp_compat.ports.port import PortCore
from yarp_compat.sig.image import ImageRgb
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.profile import Profile

_WAIT = 20.0


class Listener:
    """The program's ports and what it heard."""

    def __init__(self, port: int) -> None:
        self._naming = NameClient(Address("127.0.0.1", port))
        self._ports: list[PortCore] = []
        self._pose: list[float] | None = None
        self._static_frames: set[str] = set()
        self.voice = Voice(lambda: {"pose": self._pose})
        self._wait_for_names()
        self._driver, self._speaker = self._port("/demo/driver:o"), self._port("/demo/speaker:o")
        self._hear(topics.SCAN, _scan)
        self._hear(topics.ODOM, self._odometry)
        self._hear(topics.IMAGE, _picture)
        self._hear(topics.TF, _frames)
        for topic in topics.HELLOS:
            self._hear(topic, _text, stamped=False)

    def _wait_for_names(self) -> None:
        end = time.monotonic() + _WAIT
        while True:
            try:
                self._naming.list()
            except NamingError:
                if time.monotonic() > end:
                    raise
                time.sleep(0.1)
            else:
                return

    def _port(self, name: str, hear: Callable[[Message], None] | None = None) -> PortCore:
        core = PortCore(name, naming=self._naming, on_message=hear)
        core.open()
        self._ports.append(core)
        return core

    def _hear(self, topic: str, describe: Callable[[bytes], str], *, stamped: bool = True) -> None:
        """Hear a topic's port once it is there."""
        ear = self.voice.ear(topic)

        def hear(message: Message) -> None:
            told = describe(bytes(message.payload))
            ear.hear(message.envelope.partition(" ")[2] or None if stamped else told, told)

        core = self._port(f"/demo{topic}:i", hear)
        link = threading.Thread(target=self._connect, args=(f"/midspan{topic}:o", core.name), name=topic, daemon=True)
        link.start()

    def _connect(self, source: str, target: str) -> None:
        end = time.monotonic() + _WAIT
        while time.monotonic() < end:
            with contextlib.suppress(NamingError):
                connections.connect(self._naming, source, target)
                return
            time.sleep(0.1)

    def join_late(self) -> None:
        """Listen to what was published once, long ago."""
        self._hear(topics.MAP, _map)
        self._hear(topics.TF_STATIC, self._mounts, stamped=False)

    def drive(self, linear: float, angular: float, seconds: float, text: bool = False) -> None:
        """Send a velocity for some seconds, then fall silent; tells where the robot was and is."""
        before, sent = self._pose, 0
        send = self._text_sender() if text else self._binary_sender()
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            send(linear, angular)
            sent += 1
            time.sleep(1 / topics.DRIVE_RATE)
        self.voice.tell("drove", before=before, after=self._pose, sent=sent)

    def _binary_sender(self) -> Callable[[float, float], None]:
        while not self._driver.outputs():
            self._driver.add_output(f"/midspan{topics.CMD_VEL}:i")
            time.sleep(0.05)
        return lambda linear, angular: _ignore(self._driver.write(encode([linear, 0.0, angular], Profile.YARP3)))

    def _text_sender(self) -> Callable[[float, float], None]:
        """What anybody can do with telnet: introduce oneself, then two lines for each message."""
        contact = self._naming.query(f"/midspan{topics.CMD_VEL}:i")
        assert contact is not None
        self._line = socket.create_connection((contact.host, contact.port), 5.0)
        self._line.sendall(b"CONNECT driver\r\n")
        return lambda linear, angular: self._line.sendall(f"D\r\n{linear} 0.0 {angular}\r\n".encode())

    def say_hello(self, ended: threading.Event) -> None:
        """Say hello once in a while until the event is set."""
        number = 0
        while not ended.wait(1 / topics.HELLO_RATE):
            linked = {route.target for route in self._speaker.outputs()}
            for target in {f"/midspan{topics.FROM_YARP}:i", f"/demo{topics.FROM_YARP}:i"} - linked:
                self._speaker.add_output(target)
            number += 1
            self._speaker.write(encode([f"hello {number} from YARP"], Profile.YARP3))

    def close(self) -> None:
        """Leave the network."""
        for core in self._ports:
            core.close()

    def _odometry(self, payload: bytes) -> str:
        odometry = OdometryData.from_bytes(payload)
        self._pose = [odometry.odom_x, odometry.odom_y, math.radians(odometry.odom_theta)]
        return f"at {odometry.odom_x:.2f}, {odometry.odom_y:.2f} m"

    def _mounts(self, payload: bytes) -> str:
        self._static_frames.update(child for _, child in _pairs(payload))
        return ", ".join(sorted(self._static_frames))


def _ignore(_: int) -> None:
    """How many took it is no matter."""


def _scan(payload: bytes) -> str:
    scan = LaserScan2D.from_bytes(payload)
    return f"{len(scan.scans)} ranges, nearest {min(scan.scans):.2f} m"


def _picture(payload: bytes) -> str:
    picture = ImageRgb.from_bytes(payload)
    return f"{picture.width()} x {picture.height()} rgb8, {picture.numpy().nbytes} bytes"


def _text(payload: bytes) -> str:
    return str(decode(payload)[0])


def _map(payload: bytes) -> str:
    """A ``MapGrid2D``: rows from the top down, 255 for unknown."""
    width, height, *_, occupancy, _flags = decode(payload)
    cells = np.frombuffer(occupancy, np.uint8).reshape(height, width)[::-1]
    return wording.grid_text(width, height, cells.astype(np.int8).tobytes())


def _pairs(payload: bytes) -> list[tuple[str, str]]:
    """Frame and child frame of each transform, in the layout of YARP's converter of ROS messages."""
    values: list[Any] = decode(payload)
    return [(head[2], child) for head, child, _ in values[0]]


def _frames(payload: bytes) -> str:
    return ", ".join(f"{frame} to {child}" for frame, child in _pairs(payload))


def main() -> int:
    """Run until the standard input ends."""
    serve(Listener(int(sys.argv[1])))
    return 0


if __name__ == "__main__":
    sys.exit(main())
