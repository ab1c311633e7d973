"""Ports of a robot's files, connected to a module's."""

import threading
import time

import pytest

from navigation.connected import Connected
from yarp_compat.naming.naming import Naming


class Hanging:
    """A name server that does not answer for long."""

    def __init__(self) -> None:
        self.asked, self.goes_on = threading.Event(), threading.Event()

    def query(self, *_arguments: object, **_options: object) -> None:
        self.asked.set()
        self.goes_on.wait(40)


@pytest.fixture
def names():
    hanging = Hanging()
    yield hanging
    hanging.goes_on.set()


def test_a_module_stops_in_time_also_while_its_ports_are_being_connected(names: Naming):
    """`bridge.modules.running` gives it one second; what hangs here does for longer than a loaded machine takes."""
    connected = Connected(names, "/laser:o", "/mine/laser:i")
    assert names.asked.wait(40)
    begun = time.monotonic()
    connected.close()
    assert time.monotonic() - begun < 20.0
    assert connected.trouble == "/laser:o is not connected yet"
