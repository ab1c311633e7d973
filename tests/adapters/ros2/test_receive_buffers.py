"""Datagrams that the kernel drops for lack of room, at real sockets, and at the participant's own."""

from __future__ import annotations

import signal
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from bridge.adapters.ros2 import receive_buffers
from bridge.adapters.ros2.graph.neighbors import UdpSocket, udp_sockets
from bridge.adapters.ros2.receive_buffers import CURE, LIMIT, WANTED, DropWatch, setting
from tests.adapters.ros2.graph.test_interfaces import Calls
from tests.adapters.ros2.test_crossing import Programs, programs
from tests.peers.ros2.network import ros2_domain
from tests.support.missing import ROS2, needs
from tests.support.process import Process, is_stopped
from tests.support.wait import until

__all__ = ["programs"]

pytestmark = pytest.mark.skipif(not Path("/proc/net/udp").exists(), reason="needs Linux's /proc")

DATAGRAM = bytes(60_000)
MOST = 2000


class Clock:
    """The watch's monotonic clock."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 1000.0
        monkeypatch.setattr(receive_buffers, "time", SimpleNamespace(monotonic=lambda: self.now))


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


@pytest.fixture(params=[socket.AF_INET, socket.AF_INET6], ids=["IPv4", "IPv6"])
def receiver(request: pytest.FixtureRequest) -> Iterator[socket.socket]:
    """A socket with a small buffer."""
    with socket.socket(request.param, socket.SOCK_DGRAM) as sock:
        try:
            sock.bind(("127.0.0.1" if request.param == socket.AF_INET else "::1", 0))
        except OSError:
            pytest.skip("no IPv6 here")
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
        yield sock


def overflow(receiver: socket.socket) -> None:
    """Have the kernel drop datagrams at a socket."""
    with socket.socket(receiver.family, socket.SOCK_DGRAM) as sender:
        for _ in range(5):
            sender.sendto(bytes(1000), receiver.getsockname())


@pytest.fixture
def small_limit(tmp_path: Path) -> Path:
    """The process table of a machine whose kernel grants little."""
    for name in ("net", "self"):
        (tmp_path / name).symlink_to(f"/proc/{name}")
    (tmp_path / "sys/net/core").mkdir(parents=True)
    (tmp_path / "sys/net/core/rmem_max").write_text("212992\n")
    return tmp_path


def test_drops_are_counted_and_logged_once_a_minute(
    receiver: socket.socket, clock: Clock, caplog: pytest.LogCaptureFixture
) -> None:
    def lines() -> list[str]:
        return [record.getMessage() for record in caplog.records if record.name == receive_buffers.__name__]

    watch = DropWatch(Calls())
    watch.check()
    assert watch.text == ""
    counts = []
    for _ in range(3):
        overflow(receiver)
        watch.check()
        counts.append(int(watch.text.split()[3]))
        clock.now += 25.0
    assert 0 < counts[0] < counts[1] < counts[2]
    assert len(lines()) == 1, "within a minute"
    watch.check()
    assert len(lines()) == 2, "the later drops"
    assert f"dropped {counts[2]} UDP datagrams" in lines()[1]
    clock.now += 60.0
    watch.check()
    assert len(lines()) == 2, "no further drops"
    clock.now += 600.0
    assert watch.text == ""


def test_the_count_includes_closed_sockets(receiver: socket.socket) -> None:
    watch = DropWatch(Calls())
    overflow(receiver)
    watch.check()
    before = watch.text
    receiver.close()
    watch.check()
    assert watch.text == before != ""


def test_drops_at_other_processes_do_not_count() -> None:
    program = (
        "import socket, sys; s = socket.socket(type=socket.SOCK_DGRAM); s.bind(('127.0.0.1', 0));"
        "s.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1); print(s.getsockname()[1], flush=True); sys.stdin.read()"
    )
    with (
        Process([sys.executable, "-c", program], pipes=True) as other,
        socket.socket(type=socket.SOCK_DGRAM) as sender,
    ):
        assert other.popen.stdout is not None
        port = int(other.popen.stdout.readline())
        for _ in range(5):
            sender.sendto(bytes(1000), ("127.0.0.1", port))
        assert any(listed.port == port and listed.drops for listed in udp_sockets() or ())
        watch = DropWatch(Calls())
        watch.check()
    assert watch.text == ""


def test_the_cure_is_a_larger_limit_or_less_load(receiver: socket.socket, small_limit: Path) -> None:
    watch = DropWatch(Calls(), small_limit)
    overflow(receiver)
    watch.check()
    assert watch.text.endswith(f"; net.core.rmem_max is 212992, less than {WANTED}; {CURE}")
    (small_limit / "sys/net/core/rmem_max").write_text(f"{WANTED}\n")
    assert watch.text.endswith("; send fewer or smaller messages, or reduce the load of this machine")


@needs(ROS2)
def test_the_participant_gets_a_large_buffer_and_reports_drops(programs: Programs) -> None:
    edge = programs.edge(transport="udp")
    assert not [text for text in edge.ask("status")["warnings"] if "dropped" in text]
    limit = setting(LIMIT)
    edge.signal(signal.SIGSTOP)
    until(lambda: is_stopped(edge.pid), "it is stopped")
    sent = fill(edge.pid)
    edge.signal(signal.SIGCONT)
    assert limit is None or sent >= min(limit, WANTED), "the buffer's size is what the kernel allows"
    until(lambda: [text for text in edge.ask("status")["warnings"] if "dropped" in text], "it warns", 20)


def fill(pid: int) -> int:
    """Send datagrams to a socket of a process until the kernel drops one; return the bytes before."""
    (target, *_) = own_sockets(pid)
    with socket.socket(type=socket.SOCK_DGRAM) as sender:
        for number in range(MOST):
            sender.sendto(DATAGRAM, ("127.0.0.1", target.port))
            if any(listed.inode == target.inode and listed.drops > target.drops for listed in udp_sockets() or ()):
                return number * len(DATAGRAM)
    raise AssertionError(f"no drop after {MOST} datagrams")


def own_sockets(pid: int) -> list[UdpSocket]:
    """Return the UDP sockets of a process at the ports of this test's domain (RTPS 2.3, 9.6.1.1), the highest first."""
    first = 7400 + 250 * ros2_domain()
    targets = {str(descriptor.readlink()) for descriptor in Path(f"/proc/{pid}/fd").iterdir()}
    listed = [found for found in udp_sockets() or () if f"socket:[{found.inode}]" in targets]
    in_domain = [found for found in listed if first <= found.port < first + 250]
    return sorted(in_domain, key=lambda found: found.port, reverse=True)
