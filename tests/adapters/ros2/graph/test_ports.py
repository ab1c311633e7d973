"""Ports of Fast DDS at which a process listens although their file was removed or replaced, with real files."""

from __future__ import annotations

import mmap
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from bridge.adapters.ros2.graph.ports import PortWatch, lost_ports
from tests.adapters.ros2.graph.test_interfaces import Calls

OWN = Path("/proc/self")
PORT, PORT_3 = "fastrtps_port7411", "fastdds_port7411"
"""Ports of Fast DDS 2 and 3."""

pytestmark = pytest.mark.skipif(not OWN.is_dir(), reason="needs Linux's /proc")


@contextmanager
def opened(port: Path, *, listening: bool = True) -> Iterator[None]:
    """Use a port as Fast DDS does: mapped, and locked if the process listens at it."""
    port.write_bytes(bytes(4096))
    lock = port.with_name(f"{port.name}_el")
    with ExitStack() as stack:
        with port.open("r+b") as file:
            stack.enter_context(mmap.mmap(file.fileno(), 4096))
        if listening:
            lock.touch()
            stack.enter_context(lock.open())
        yield


@pytest.mark.parametrize("name", [PORT, PORT_3])
def test_a_removed_or_replaced_port_is_lost(tmp_path: Path, name: str) -> None:
    port = tmp_path / name
    with opened(port):
        assert lost_ports(OWN, tmp_path) == set()
        port.unlink()
        assert lost_ports(OWN, tmp_path) == {name}
        port.touch()
        assert lost_ports(OWN, tmp_path) == {name}, "a writer has created it again"
        (tmp_path / f"{name}_el").unlink()
        assert lost_ports(OWN, tmp_path) == {name}, "the lock may be removed, too"
        with opened(port):
            assert lost_ports(OWN, tmp_path) == set(), (
                "its thread has created it again, and the old one is still mapped"
            )


def test_ports_to_which_a_process_writes_are_not_lost(tmp_path: Path) -> None:
    with opened(tmp_path / PORT, listening=False):
        (tmp_path / PORT).unlink()
        assert lost_ports(OWN, tmp_path) == set()


def test_an_ended_process_has_lost_no_port(tmp_path: Path) -> None:
    assert lost_ports(tmp_path / "none", tmp_path) == set()


class Watched:
    """A watch whose process has lost the ports ``lost``."""

    def __init__(self) -> None:
        self.calls, self.lost, self.reports = Calls(), frozenset[str](), list[str]()
        self.watch = PortWatch(lambda: self.reports.append("lost"), self.calls, lambda: self.lost)


def test_a_lost_port_is_reported_once_it_is_confirmed() -> None:
    watched = Watched()
    watched.calls.pass_period()
    watched.lost = frozenset({PORT})
    watched.calls.pass_period()
    assert watched.reports == []
    watched.calls.pass_period()
    assert watched.reports == ["lost"]


def test_a_port_that_its_thread_replaces_is_not_reported() -> None:
    watched = Watched()
    for lost in ({PORT}, {PORT_3}, set[str]()):
        watched.lost = frozenset(lost)
        watched.watch.check()
        watched.calls.pass_period()
        watched.lost = frozenset()
        watched.calls.pass_period()
    assert watched.reports == []


def test_a_process_that_was_suspended_checks_at_once() -> None:
    watched = Watched()
    watched.calls.waiting.clear()
    watched.lost = frozenset({PORT})
    watched.watch.check()
    watched.calls.pass_period()
    watched.calls.pass_period()
    assert watched.reports == ["lost"]
