"""Lookups and inserts of Midspan's transform buffer and of ROS 1's tf2 (tf2_py), each in a separate process.

Both process the same transforms and lookups, and take turns, round by round. For the inserts, tf2's messages are
created beforehand; for the inserts from message bytes they are deserialized during the measurement, as in a listener.
tf2's results are messages, as its users receive them. Each figure is the median over the rounds.

``--relay`` measures the latency of transforms between ROS 1 and ROS 2 at 1 kHz through the daemon, and the floor
of the same hops without the daemon, as in `benchmarks.topic_latency`.
"""

from __future__ import annotations

import argparse
import io
import json
import math
import random
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

if not __package__:  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.rows import Row, add_json_option, report

SYSTEM_PYTHON = "/usr/bin/python3"
SECOND = 1_000_000_000
FRAMES = 20  # frames of the chain
SAMPLES = 500  # samples of each frame
RATE = 100  # samples per second
START = 1_000_000 * SECOND
BATCH = 720  # times of one `lookup_many`
LOOKUPS = 5_000  # lookups of a round
RELAY_RATE = 1000  # messages per second with ``--relay``

Sample = tuple[str, str, int, tuple[float, float, float], tuple[float, float, float, float]]
Measure = Callable[[], float]


def samples() -> list[Sample]:
    """Return the samples of a chain of moving frames, in temporal order."""
    dice = random.Random(6)
    turns = [[dice.gauss(0, 1) for _ in range(4)] for _ in range(FRAMES)]
    chain: list[Sample] = []
    for n in range(SAMPLES):
        for k, turn in enumerate(turns):
            parts = [part + 0.001 * n for part in turn]
            length = math.sqrt(sum(part * part for part in parts))
            x, y, z, w = (part / length for part in parts)
            chain.append((f"f{k}", f"f{k + 1}", START + n * SECOND // RATE, (0.1 * k, 0.01 * n, 1.0), (x, y, z, w)))
    return chain


def stamps(count: int) -> list[int]:
    """Return random times within the history, in nanoseconds."""
    dice = random.Random(7)
    return [START + dice.randrange((SAMPLES - 1) * SECOND // RATE) for _ in range(count)]


def per_second(count: int, work: Callable[[], object]) -> float:
    """Return the rate per second of work with ``count`` parts."""
    start = time.perf_counter()
    work()
    return count / (time.perf_counter() - start)


def ours() -> dict[str, Measure]:
    """Return the cases with Midspan's buffer."""
    from bridge.tf.buffer import TransformBuffer  # not available on the system's Python
    from bridge.tf.stamped import Stamped, write

    stored, times = samples(), stamps(LOOKUPS)
    messages = [
        write([Stamped(*sample) for sample in stored[at : at + FRAMES]]) for at in range(0, len(stored), FRAMES)
    ]
    buffer = TransformBuffer()

    def insert(into: TransformBuffer) -> None:
        for parent, child, stamp, moved, turned in stored:
            into.set_transform(parent, child, stamp, moved, turned, "bench")

    def receive(into: TransformBuffer) -> None:
        for cdr in messages:
            into.set_message(cdr, "bench")

    def lookup(frame: str) -> None:
        for stamp in times:
            buffer.lookup_transform("f0", frame, stamp)

    def latest(frame: str) -> None:
        for _ in times:
            buffer.lookup_transform("f0", frame)

    def batch(frame: str) -> None:
        for at in range(0, LOOKUPS // BATCH * BATCH, BATCH):
            buffer.lookup_many("f0", frame, times[at : at + BATCH])

    insert(buffer)
    return _measures(lambda: insert(TransformBuffer()), lambda: receive(TransformBuffer()), lookup, latest, batch)


def tf2() -> dict[str, Measure]:
    """Return the cases with tf2; it has no lookup of many times at once, so that case is a loop."""
    import genpy  # only available on the system's Python
    import tf2_py
    from geometry_msgs.msg import Quaternion, TransformStamped, Vector3
    from tf2_msgs.msg import TFMessage

    times = [genpy.Time(*divmod(stamp, SECOND)) for stamp in stamps(LOOKUPS)]
    stored = []
    for parent, child, stamp, moved, turned in samples():
        message = TransformStamped()
        message.header.frame_id, message.child_frame_id = parent, child
        message.header.stamp = genpy.Time(*divmod(stamp, SECOND))
        message.transform.translation, message.transform.rotation = Vector3(*moved), Quaternion(*turned)
        stored.append(message)
    messages = []
    for at in range(0, len(stored), FRAMES):
        content = io.BytesIO()
        TFMessage(stored[at : at + FRAMES]).serialize(content)
        messages.append(content.getvalue())
    buffer = tf2_py.BufferCore(genpy.Duration(10.0))
    newest = genpy.Time()

    def insert(into: Any) -> None:
        for message in stored:
            into.set_transform(message, "bench")

    def receive(into: Any) -> None:
        for content in messages:
            for message in TFMessage().deserialize(content).transforms:
                into.set_transform(message, "bench")

    def lookup(frame: str) -> None:
        for stamp in times:
            buffer.lookup_transform_core("f0", frame, stamp)

    def latest(frame: str) -> None:
        for _ in times:
            buffer.lookup_transform_core("f0", frame, newest)

    def batch(frame: str) -> None:
        for stamp in times[: LOOKUPS // BATCH * BATCH]:
            buffer.lookup_transform_core("f0", frame, stamp)

    insert(buffer)

    def fresh() -> Any:
        return tf2_py.BufferCore(genpy.Duration(10.0))

    return _measures(lambda: insert(fresh()), lambda: receive(fresh()), lookup, latest, batch)


def _measures(
    insert: Callable[[], None],
    hear: Callable[[], None],
    lookup: Callable[[str], None],
    latest: Callable[[str], None],
    batch: Callable[[str], None],
) -> dict[str, Measure]:
    cases: dict[str, Measure] = {
        "insert": lambda: per_second(FRAMES * SAMPLES, insert),
        f"insert by messages of {FRAMES}": lambda: per_second(FRAMES * SAMPLES, hear),
    }
    whole = LOOKUPS // BATCH * BATCH
    for depth in (5, FRAMES):
        frame = f"f{depth}"
        cases[f"lookup through {depth}"] = lambda frame=frame: per_second(LOOKUPS, lambda: lookup(frame))  # type: ignore[misc]
        cases[f"latest through {depth}"] = lambda frame=frame: per_second(LOOKUPS, lambda: latest(frame))  # type: ignore[misc]
        cases[f"{BATCH} times at once through {depth}"] = lambda frame=frame: per_second(whole, lambda: batch(frame))  # type: ignore[misc]
    return cases


def serve(side: str) -> None:
    """Measure each case named on standard input."""
    cases = ours() if side == "ours" else tf2()
    print(json.dumps(list(cases)), flush=True)
    for line in sys.stdin:
        print(json.dumps(cases[line.strip()]()), flush=True)


class Side:
    """The process with Midspan's buffer, or the one with tf2."""

    def __init__(self, side: str, python: str) -> None:
        command = [python, str(Path(__file__).resolve()), "--side", side]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.cases: list[str] = self._answer()

    def measure(self, case: str) -> float:
        """Measure one round of a case, per second."""
        assert self._process.stdin is not None
        print(case, file=self._process.stdin, flush=True)
        return float(self._answer())

    def close(self) -> None:
        """Let the process exit."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()

    def _answer(self) -> Any:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            self._process.wait()
            msg = "a process has exited; tf2 needs python3-tf2 (Debian, Ubuntu: apt install python3-tf2)"
            raise SystemExit(msg)
        return json.loads(line)


def compare(rounds: int) -> list[Row]:
    """Measure all cases, and return the rows."""
    sides = [Side("ours", sys.executable), Side("tf2", SYSTEM_PYTHON)]
    try:
        rates: dict[str, list[list[float]]] = {case: [[], []] for case in sides[0].cases}
        for number in range(rounds):
            for case, figures in rates.items():
                for which in (0, 1) if number % 2 == 0 else (1, 0):
                    figures[which].append(sides[which].measure(case))
    finally:
        for side in sides:
            side.close()
    thousands = {case: [statistics.median(side) / 1000 for side in figures] for case, figures in rates.items()}
    return [Row(f"{case}, tf2", own, peer, "k/s", "more") for case, (own, peer) in thousands.items()]


def relay(rounds: int, *, realtime: bool) -> list[Row]:
    """Measure transforms at 1 kHz between ROS 1 and ROS 2: the whole path and the floor."""
    from benchmarks.latency.cases import CASES
    from benchmarks.latency.network import Network
    from benchmarks.topic_latency import Samples

    usual = next(case for case in CASES if case.key == "tf")
    case = replace(usual, name=f"{usual.name} at {RELAY_RATE} Hz", rate=float(RELAY_RATE), count=5 * RELAY_RATE)
    measured = Samples()
    for number in range(rounds):
        with Network([case], idle=0, busy=0, shared_memory=True) as network:
            if realtime:
                network.prefer()
            measured.round(network, number)
    print(f"{measured.hops_text([case])}\n{measured.lost} of {measured.sent} messages lost", file=sys.stderr)
    return measured.rows([case], "")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=11, help="rounds of each case (default 11)")
    parser.add_argument("--relay", action="store_true", help="measure the relay of transforms between ROS 1 and ROS 2")
    parser.add_argument("--realtime", action="store_true", help="with --relay: as in topic_latency.py")
    parser.add_argument("--side", choices=("ours", "tf2"), help=argparse.SUPPRESS)
    add_json_option(parser)
    options = parser.parse_args(arguments)
    if options.side:
        serve(options.side)
    else:
        rows = relay(options.rounds, realtime=options.realtime) if options.relay else compare(options.rounds)
        report(rows, options.json)


if __name__ == "__main__":
    main()
