"""A folder like ``/proc`` in which programs of given YARP releases own given connections."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from ipaddress import ip_address
from pathlib import Path

Address = tuple[str, int]
_MAPS = (
    "7f0000000000-7f0000001000 r-xp 00000000 08:01 1 /usr/lib/x86_64-linux-gnu/libc.so.6\n"
    "7f0000002000-7f0000003000 r--p 00000000 08:01 2 {library}\n"
    "7f0000003000-7f0000004000 r-xp 00001000 08:01 2 {library}\n"
)


def library(release: str) -> str:
    """Return the path of a release's YARP library, as packages install it."""
    return f"/usr/local/lib/libYARP_os.so.{release}"


def processes(folder: Path, owners: Mapping[Address, Iterable[str]], state: str = "01") -> Path:
    """Write a process for each connection; the process has mapped the given files."""
    lines = ["  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode"]
    (folder / "net").mkdir(parents=True, exist_ok=True)
    for at, (address, files) in enumerate(owners.items()):
        inode, process = 9000 + at, folder / str(4700 + at)
        lines.append(
            f"   {at}: {listed(address)} 0100007F:4E20 {state} 00000000:00000000 00:00000000 00000000  1000 0 {inode} 1"
        )
        (process / "fd").mkdir(parents=True, exist_ok=True)
        (process / "fd" / "0").symlink_to("/dev/null")
        (process / "fd" / "3").symlink_to(f"socket:[{inode}]")
        (process / "maps").write_text("".join(_MAPS.format(library=file) for file in files))
    (folder / "net" / "tcp").write_text("\n".join(lines) + "\n")
    return folder


def listed(address: Address) -> str:
    """Return an address as ``/proc/net/tcp`` lists it, with words in the machine's byte order."""
    packed = ip_address(address[0]).packed
    numbers = struct.unpack(f"={len(packed) // 4}I", packed)
    return "".join(f"{number:08X}" for number in numbers) + f":{address[1]:04X}"
