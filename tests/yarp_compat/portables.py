"""Reads ``data/portables.txt``: the bytes that a real YARP 4.0 gave single values and objects."""

from __future__ import annotations

import re
from pathlib import Path

_FILE = Path(__file__).parent / "data" / "portables.txt"
_HEAD = re.compile(r"(?:text: .*|.*: )?(?P<name>\S.*?) \((?P<size>\d+) B\)$")
_BYTES = re.compile(r" +[0-9a-f]{4}  ((?:[0-9a-f]{2} ?)+)")


def portables() -> dict[str, bytes]:
    """The bytes by name; where a name stands more than once, later ones have ``#2`` and so on behind it."""
    found: dict[str, bytes] = {}
    name = ""
    for line in _FILE.read_text().splitlines():
        head = _HEAD.match(line)
        if head:
            name, again = head["name"], 1
            while name in found:
                again += 1
                name = f"{head['name']}#{again}"
            found[name] = b""
        elif (data := _BYTES.match(line)) and name:
            found[name] += bytes.fromhex(data[1])
    return found


def typed() -> dict[str, bytes]:
    """``data/typed-3.12.3.txt``: the bytes that a real YARP 3.12.3 gave typed values, by name."""
    lines = (_FILE.parent / "typed-3.12.3.txt").read_text().splitlines()
    return {name: bytes.fromhex(data) for name, data in (line.split() for line in lines if line[0] != "#")}


PORTABLES = portables()
TYPED = typed()
