"""The YARP program of `benchmarks.frames_load`: ``yarp.py COUNT NAMESERVER-PORT``, the number of frames per tick.

It runs twice: one process sets transforms, the other reads the stream.
"""

from __future__ import annotations

import statistics
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from benchmarks.frameload.tally import Tally, only_answers, serve
from yarp_compat.dev.frametransform import SERVER, STREAM, AllTransforms, FrameTransform
from yarp_compat.dev.frametransform_client import TransformClient
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.pythonic import Reader


class Program:
    """The program's commands."""

    def __init__(self, frames: int, port: int) -> None:
        self.frames = frames
        self.tally = Tally(frames)
        self.names = NameClient(Address("127.0.0.1", port))
        self.client: Any = None
        self.reader: Any = None
        self.setting: Any = None
        self.sent = 0
        self._durations: list[float] = []

    def count(self) -> dict[str, Any]:
        """Start counting the streamed messages."""
        reader = self.reader = Reader("", naming=self.names, strict=True).open()
        connections.connect(self.names, SERVER + STREAM, reader.name)

        def read() -> None:
            for message in reader:
                transforms = message.to(AllTransforms).transforms_list
                ticks = [round(transform.tX) for transform in transforms if transform.dst_frame_id.startswith("load")]
                if ticks:
                    self.tally.see(ticks)

        threading.Thread(target=read, daemon=True).start()
        return {}

    def mount(self, frames: list[str]) -> dict[str, Any]:
        """Set static frames."""
        self.client = TransformClient(naming=self.names).open()
        self.client.set_all({(name, "base"): np.eye(4) for name in frames}, static=True)
        return {}

    def set(self, rate: float, ticks: int, first: int) -> dict[str, Any]:
        """Start to set all frames in one request per tick, at ``rate`` ticks per second, numbered from ``first``."""
        self.sent, self._durations = 0, []
        transforms = [FrameTransform("base", f"load{n}") for n in range(self.frames)]

        def work() -> None:
            with TransformClient(naming=self.names, streaming=False) as client:
                due = time.monotonic()
                for tick in range(first, first + ticks):
                    now = time.time()
                    for transform in transforms:
                        transform.timestamp, transform.tX = now, float(tick)
                    start = time.monotonic()
                    assert client.send(transforms)
                    self._durations.append(time.monotonic() - start)
                    self.sent = tick - first + 1
                    due += 1.0 / rate
                    time.sleep(max(0.0, due - time.monotonic()))

        self.setting = threading.Thread(target=work, daemon=True)
        self.setting.start()
        return {}

    def done(self, seconds: float) -> dict[str, Any]:
        """Wait at most ``seconds`` until all ticks are sent; return their number, and the median of a request in ms."""
        self.setting.join(seconds)
        return {"sent": self.sent, "ms": 1000 * statistics.median(self._durations) if self._durations else 0.0}

    def join(self, count: int, frames: list[str], seconds: float) -> dict[str, Any]:
        """Connect to the server as a late joiner, ``count`` times, each with a new client.

        Each attempt ends when all frames have arrived, or after ``seconds``. Return the number of attempts in which all
        frames arrived, and the duration of the slowest attempt.
        """
        whole, slowest = 0, 0.0
        for _ in range(count):
            start = time.monotonic()
            with TransformClient(naming=self.names) as client:
                whole += client.wait_until(lambda tree: all(name in tree for name in frames), seconds)
                slowest = max(slowest, time.monotonic() - start)
        return {"whole": whole, "slowest": slowest}

    def close(self) -> None:
        for end in (self.reader, self.client):
            if end is not None:
                end.close()


def main() -> None:
    answers = only_answers()
    program = Program(int(sys.argv[1]), int(sys.argv[2]))
    serve(answers, {
        "count": program.count, "report": program.tally.report, "mount": program.mount, "join": program.join,
        "set": program.set, "done": program.done,
    })  # fmt: skip
    program.close()


main()
