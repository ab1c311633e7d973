"""Detects the YARP release of a client on this machine by the library that its process has loaded (Linux).

The file name of ``libYARP_os`` contains the full version: ``libYARP_os.so.3.9.1``. Processes of other users, in other
containers or on other machines cannot be inspected.
"""

from __future__ import annotations

import contextlib
import ipaddress
import os
import re
import sys
from pathlib import Path

from yarp_compat.wire.generation import Generation, Generations, PeerAddress, ReleaseFinding
from yarp_compat.wire.profile import Profile

_PROC = Path("/proc")
_LIBRARY = re.compile(rb"/libYARP_os(?:-[0-9a-f]+)?\.so\.(\d+\.\d+\.\d+)(?: \(deleted\))?$", re.MULTILINE)
_ESTABLISHED = "01"


def inspect_client(
    generations: Generations, peer: str, profile: Profile | None, link: PeerAddress, address: PeerAddress | None = None
) -> None:
    """Record the release that a client's process has loaded, if it is only a guess so far; once per connection.

    ``address`` is the client's end of the connection, by default ``link``.
    """
    if generations.inspects(peer, profile, link):
        finding = loaded_release(address or link)
        if finding is not None:
            generations.findings.add(peer, finding, link)


def loaded_release(address: PeerAddress, proc: Path | None = None) -> ReleaseFinding | None:
    """Return the release that the process at one end of a TCP connection has loaded, if it can be read."""
    proc = proc or _PROC
    inode = _inode(address, proc)
    process = None if inode is None else _owner(inode, proc)
    if process is None:
        return None
    with contextlib.suppress(OSError, ValueError):
        releases = {match.decode() for match in _LIBRARY.findall((process / "maps").read_bytes())}
        if len(releases) == 1:
            release = releases.pop()
            reason = f"its process {process.name} on this machine has loaded YARP {release}"
            return ReleaseFinding(Generation.of(release), reason)
    return None


def _inode(address: PeerAddress, proc: Path) -> str | None:
    """Return the inode of the socket with this local address, from ``/proc/net/tcp``."""
    try:
        host = ipaddress.ip_address(address[0].partition("%")[0])
    except ValueError:
        return None
    mapped = getattr(host, "ipv4_mapped", None) or host
    plain = mapped.packed
    wanted = {_hex(plain, address[1]), _hex(bytes(10) + b"\xff\xff" + plain, address[1])}
    for name in ("tcp", "tcp6"):
        with contextlib.suppress(OSError), (proc / "net" / name).open() as table:
            for line in table:
                fields = line.split()
                if len(fields) > 9 and fields[1] in wanted and fields[3] == _ESTABLISHED:
                    return fields[9]
    return None


def _hex(packed: bytes, port: int) -> str:
    groups = (int.from_bytes(packed[at : at + 4], sys.byteorder) for at in range(0, len(packed), 4))
    return f"{''.join(f'{group:08X}' for group in groups)}:{port:04X}"


def _owner(inode: str, proc: Path) -> Path | None:
    """Return the ``/proc`` folder of the process that has the socket open."""
    wanted = f"socket:[{inode}]"
    for name in filter(str.isdecimal, _names(proc)):
        descriptors = f"{proc}/{name}/fd"
        if any(_target(f"{descriptors}/{number}") == wanted for number in _names(descriptors)):
            return proc / name
    return None


def _names(folder: Path | str) -> list[str]:
    """Return the names in a folder; empty if the process has ended or belongs to another user."""
    try:
        return os.listdir(folder)  # noqa: PTH208 - pathlib is slow for a machine's processes
    except OSError:
        return []


def _target(link: str) -> str:
    try:
        return os.readlink(link)  # noqa: PTH115 - as above
    except OSError:
        return ""
