"""A YARP program of the demo: reads from ports, drives with short Bottles, and once with text lines on a socket.

Usage: ``python -m bridge.demo.topics_demo.yarp_program NAME_SERVER_PORT``.
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
from typing_extensions import override

from bridge.demo.topics_demo import messages
from bridge.demo.topics_demo.report import TopicsProgram, serve
from yarp_compat.dev.basecontrol import OdometryData
from yarp_compat.dev.rangefinder import LaserScan2D
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import NamingError
from yarp_compat.ports.port import PortCore
from yarp_compat.sig.image import ImageRgb
from yarp_compat.wire.binary import decode, encode
from yarp_compat.wire.profile import Profile


class YarpProgram(TopicsProgram):
    """The program's ports, and what it received."""

    def __init__(self, port: int) -> None:
        super().__init__()
        self._naming = NameClient(Address("127.0.0.1", port))
        self._ports: list[PortCore] = []
        self._closed = threading.Event()
        self._wait_for_names()
        self._driver, self._speaker = self._port("/demo/driver:o"), self._port("/demo/speaker:o")
        self._subscribe(messages.SCAN, _scan)
        self._subscribe(messages.ODOM, self._odometry)
        self._subscribe(messages.IMAGE, _picture)
        self._subscribe(messages.TF, _frames)
        for topic in messages.HELLOS:
            self._subscribe(topic, _text, stamped=False)

    def _wait_for_names(self) -> None:
        """Wait for the name server; the demo limits the time."""
        while True:
            with contextlib.suppress(NamingError):
                self._naming.list()
                return
            time.sleep(0.1)

    def _port(self, name: str, on_message: Callable[[PortMessage], None] | None = None) -> PortCore:
        core = PortCore(name, naming=self._naming, on_message=on_message)
        core.open()
        self._ports.append(core)
        return core

    def _subscribe(self, topic: str, describe: Callable[[bytes], str], *, stamped: bool = True) -> None:
        """Connect to a topic's port once it is registered."""
        received = self.reporter.received(topic)

        def on_message(message: PortMessage) -> None:
            text = describe(bytes(message.payload))
            received.add(message.envelope.partition(" ")[2] or None if stamped else text, text)

        core = self._port(f"/demo{topic}:i", on_message)
        link = threading.Thread(target=self._connect, args=(f"/midspan{topic}:o", core.name), name=topic, daemon=True)
        link.start()

    def _connect(self, source: str, target: str) -> None:
        while not self._closed.is_set():
            with contextlib.suppress(NamingError):
                connections.connect(self._naming, source, target)
                return
            self._closed.wait(0.1)

    @override
    def join_late(self) -> None:
        self._subscribe(messages.MAP, _map)
        self._subscribe(messages.TF_STATIC, self._mounts, stamped=False)

    @override
    def drive(self, linear: float, angular: float, seconds: float, text: bool = False) -> None:
        self._send_velocity(self._text_sender() if text else self._binary_sender(), linear, angular, seconds)

    def _binary_sender(self) -> Callable[[float, float], object]:
        while not self._driver.outputs():
            self._driver.add_output(f"/midspan{messages.CMD_VEL}:i")
            time.sleep(0.05)
        return lambda linear, angular: self._driver.write(encode([linear, 0.0, angular], Profile.YARP3))

    def _text_sender(self) -> Callable[[float, float], object]:
        """Send as with telnet: introduce the client, then two lines for each message."""
        contact = self._naming.query(f"/midspan{messages.CMD_VEL}:i")
        assert contact is not None
        self._line = socket.create_connection((contact.host, contact.port), 5.0)
        self._line.sendall(b"CONNECT driver\r\n")
        return lambda linear, angular: self._line.sendall(f"D\r\n{linear} 0.0 {angular}\r\n".encode())

    @override
    def _publish_hello(self, text: str) -> None:
        linked = {route.target for route in self._speaker.outputs()}
        for target in {f"/midspan{messages.FROM_YARP}:i", f"/demo{messages.FROM_YARP}:i"} - linked:
            self._speaker.add_output(target)
        self._speaker.write(encode([text], Profile.YARP3))

    @override
    def close(self) -> None:
        self._closed.set()
        for core in self._ports:
            core.close()

    @override
    def _odometry(self, payload: bytes) -> str:
        odometry = OdometryData.from_bytes(payload)
        self._pose = [odometry.odom_x, odometry.odom_y, math.radians(odometry.odom_theta)]
        return f"at {odometry.odom_x:.2f}, {odometry.odom_y:.2f} m"

    @override
    def _mounts(self, payload: bytes) -> str:
        return self._add_mounts(child for _, child in _pairs(payload))


def _scan(payload: bytes) -> str:
    scan = LaserScan2D.from_bytes(payload)
    return f"{len(scan.scans)} ranges, nearest {min(scan.scans):.2f} m"


def _picture(payload: bytes) -> str:
    picture = ImageRgb.from_bytes(payload)
    return f"{picture.width()} x {picture.height()} rgb8, {picture.numpy().nbytes} bytes"


def _text(payload: bytes) -> str:
    return str(decode(payload)[0])


def _map(payload: bytes) -> str:
    """Describe a ``MapGrid2D``: rows from the top down, 255 for unknown."""
    width, height, *_, occupancy, _flags = decode(payload)
    cells = np.frombuffer(occupancy, np.uint8).reshape(height, width)[::-1]
    return messages.grid_text(width, height, cells.astype(np.int8).tobytes())


def _pairs(payload: bytes) -> list[tuple[str, str]]:
    """Return frame and child frame of each transform, in the layout of YARP's converter of ROS messages."""
    values: list[Any] = decode(payload)
    return [(head[2], child) for head, child, _ in values[0]]


def _frames(payload: bytes) -> str:
    return ", ".join(f"{frame} to {child}" for frame, child in _pairs(payload))


def main() -> int:
    """Run until standard input ends."""
    serve(YarpProgram(int(sys.argv[1])), "YARP")
    return 0


if __name__ == "__main__":
    sys.exit(main())
