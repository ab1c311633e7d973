"""The YARP release of a client on this machine, by the library that its process has loaded."""

from __future__ import annotations

import mmap
import socket
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest

from tests.peers.yarp.processes import library, processes
from yarp_compat.ports.client_process import loaded_release
from yarp_compat.wire.generation import Generation

HERE = ("127.0.0.1", 41000)


@pytest.mark.parametrize(
    ("files", "generation"),
    [
        ([library("3.9.1")], Generation.YARP_3_6),
        ([library("3.10.1")], Generation.YARP_3_6),
        ([library("3.11.2")], Generation.YARP_3_11),
        (["/opt/robot/env/lib/libYARP_os.so.3.12.3"], Generation.YARP_3_12),
        ([library("4.0.0") + " (deleted)"], Generation.YARP_4),
        ([library("3.9.1"), "/usr/lib/libYARP_dev.so.3.9.1"], Generation.YARP_3_6),
        ([library("3.9.1"), library("3.12.3")], None),
        (["/home/user/venv/yarp_middleware.libs/libYARP_os-1a2b3c4d.so.3.8.1"], Generation.YARP_3_6),
        ([library("3.4.0")], None),
        (["/usr/lib/libYARP_os.so", "/home/user/notes on libYARP_os.so.3.9.1.txt"], None),
        ([], None),
    ],
)
def test_release_is_read_from_the_loaded_library(
    tmp_path: Path, files: Iterable[str], generation: Generation | None
) -> None:
    finding = loaded_release(HERE, processes(tmp_path, {HERE: files}))
    assert (finding and finding.generation) is generation
    assert finding is None or ("4700" in finding.reason and finding.sure)


def test_process_is_found_by_its_end_of_the_connection(tmp_path: Path) -> None:
    owners = {HERE: [library("3.9.1")], ("127.0.0.1", 41001): [library("3.12.3")], ("192.0.2.7", 41000): []}
    proc = processes(tmp_path, owners)
    assert [(finding and finding.generation) for finding in (loaded_release(address, proc) for address in owners)] == [
        Generation.YARP_3_6,
        Generation.YARP_3_12,
        None,
    ]
    assert loaded_release(("::ffff:127.0.0.1", 41001), proc) == loaded_release(("127.0.0.1", 41001), proc)
    for elsewhere in (("198.51.100.1", 41000), ("127.0.0.1", 41002), ("::1", 41000), ("", 0), ("robot", 41000)):
        assert loaded_release(elsewhere, proc) is None


def test_closed_connection_has_no_process(tmp_path: Path) -> None:
    assert loaded_release(HERE, processes(tmp_path, {HERE: [library("3.9.1")]}, state="06")) is None
    assert loaded_release(HERE, tmp_path / "no proc here") is None


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
def test_the_release_of_a_real_process_is_read_from_its_library(tmp_path: Path, host: str) -> None:
    """The process is the test itself, after it has mapped a file with the library's name."""
    file = tmp_path / "libYARP_os.so.3.9.1"
    file.write_bytes(bytes(mmap.PAGESIZE))
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with (
        socket.create_server((host, 0), family=family) as server,
        socket.create_connection(server.getsockname()[:2]) as client,
    ):
        address = client.getsockname()[:2]
        assert loaded_release(address) is None
        with file.open("rb") as opened, mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ):
            finding = loaded_release(address)
    assert finding is not None
    assert finding.generation is Generation.YARP_3_6
    assert "has loaded YARP 3.9.1" in finding.reason
