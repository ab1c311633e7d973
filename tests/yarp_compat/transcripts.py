"""Reads the transcripts of real YARP programs in ``tests/yarp_compat/data``: the bytes in each direction by connection.

A transcript's line ``[time] connN C>S from->to (size B)`` is followed by its bytes in hexadecimal; C opened the
connection. The transcripts were recorded on loopback from YARP 3.12.3 and 4.0; each file states its release.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

_DATA = Path(__file__).parent / "data"
_HEAD = re.compile(r"\[ *(?P<time>[\d.]+)\] conn(?P<number>\d+) (?P<what>OPEN|C>S|S>C|UDP|FIN|RST)(?P<rest>.*)")
_ENDS = re.compile(r"(\d+)->(\d+)")
_BYTES = re.compile(r" +[0-9a-f]{4}  ((?:[0-9a-f]{2} ?)+)")


@dataclass(frozen=True)
class Step:
    """Bytes from ``C`` (the side that opened the connection), from ``S`` (the other side), or in a datagram (``U``)."""

    by: str
    data: bytes
    time: float


@dataclass
class Talk:
    """One connection.

    Attributes:
        number: the connection's number in the file.
        port: the TCP port of the server.
        steps: the sent bytes in order; consecutive pieces in one direction are joined.
    """

    number: int
    port: int
    steps: list[Step] = field(default_factory=list)

    def sent_by(self, by: str) -> bytes:
        """Return all bytes that one side sent."""
        return b"".join(step.data for step in self.steps if step.by == by)


def read(name: str, *, joined: bool = True) -> list[Talk]:
    """Return all connections of a transcript in the order of opening.

    ``joined``: merge consecutive pieces in one direction, even if they have different times.
    """
    talks: dict[int, Talk] = {}
    by, moment, talk = "", 0.0, None
    for line in (_DATA / name).read_text().splitlines():
        if match := _HEAD.match(line):
            ends = _ENDS.search(match["rest"])
            port = int(ends[2]) if ends else 0
            talk = talks.setdefault(int(match["number"]), Talk(int(match["number"]), port))
            by, moment = {"C>S": "C", "S>C": "S", "UDP": "U"}.get(match["what"], ""), float(match["time"])
        elif talk is not None and by and (match := _BYTES.match(line)):
            data = bytes.fromhex(match[1])
            last = talk.steps[-1] if talk.steps else None
            if last is not None and last.by == by and (last.time == moment or (joined and by != "U")):
                talk.steps[-1] = Step(by, last.data + data, moment)
            else:
                talk.steps.append(Step(by, data, moment))
    return list(talks.values())
