"""Reads ``data/portables.txt``: the encoding of single values and objects by a real YARP 4.0."""

from __future__ import annotations

import re
from pathlib import Path

_FILE = Path(__file__).parent / "data" / "portables.txt"
_HEAD = re.compile(r"(?:text: .*|.*: )?(?P<name>\S.*?) \((?P<size>\d+) B\)$")
_BYTES = re.compile(r" +[0-9a-f]{4}  ((?:[0-9a-f]{2} ?)+)")


def portables() -> dict[str, bytes]:
    """Return the bytes by name; repeated names get the suffix ``#2`` etc."""
    data_by_name: dict[str, bytes] = {}
    name = ""
    for line in _FILE.read_text(encoding="utf-8").splitlines():
        head = _HEAD.match(line)
        if head:
            name, number = head["name"], 1
            while name in data_by_name:
                number += 1
                name = f"{head['name']}#{number}"
            data_by_name[name] = b""
        elif (data := _BYTES.match(line)) and name:
            data_by_name[name] += bytes.fromhex(data[1])
    return data_by_name


def typed() -> dict[str, bytes]:
    """Read ``data/typed-3.12.3.txt``: the encoding of typed values by a real YARP 3.12.3, by name."""
    lines = (_FILE.parent / "typed-3.12.3.txt").read_text().splitlines()
    return {name: bytes.fromhex(data) for name, data in (line.split() for line in lines if line[0] != "#")}


PORTABLES = portables()
TYPED = typed()
