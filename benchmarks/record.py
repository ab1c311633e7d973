"""Recording images at 200 MB/s and 5,000 small messages per second: losses, cost, and delay of other subscribers.

One process sends, and another one subscribes to the same topics. Three cases take turns: `midspan record`, a bare zenoh
subscriber that writes the same bytes with the library `mcap` on another thread, and no recorder. All are separate
processes on one hub, with the hub's own session configuration. Rows:

- messages lost: gaps in the sender's numbers between a topic's first and last message in the file;
- ratio of the processor times of the recorder and of the bare subscriber, per sent gigabyte (the aim is 1.3);
- ratio of the latencies of the small messages to the listener, with the recorder and without (the aim is 1.1).

Chunks are not compressed, except with ``--compression``: zstd, the default of `midspan record`, needs about 14
processor seconds per gigabyte of these images, so at 200 MB/s any writer with `mcap` would need more than two cores.
Files are written into memory (/dev/shm), except with ``--folder``, so that the disk is not measured.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from queue import SimpleQueue
from threading import Event, Thread
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).parents[1]))

import psutil

from benchmarks.rows import Row, add_json_option, report
from bridge.hub.node import Hub
from bridge.hub.session import HubSettings
from bridge.hub.wire.qos import Qos
from bridge.messages.registry import Registry

IMAGE, IMAGE_TYPE = "/camera/image", "sensor_msgs/msg/Image"
SMALL = [f"/small_{number}" for number in range(5)]
SMALL_TYPE = "geometry_msgs/msg/TwistStamped"
SIDE = 1200
"""Pixels of an image's side; with three bytes per pixel, an image has 4.3 MB."""

SMALL_RATE = 1000.0  # messages per second on each small topic
FLOW = 200e6  # bytes per second of images
SETTLE_SECONDS = 2.0  # until the last messages have arrived and have been written
ROOT = Path(__file__).parents[1]
RECORDERS = ("nobody", "midspan", "bare")


def settings(endpoint: str, node: str, domain: int = 0) -> HubSettings:
    """Return a participant's settings: the hub's defaults, without the lane."""
    return HubSettings(router=endpoint, node=node, worker=node, domain=domain)


def until_subscribed(hub: Hub, topics: Sequence[str], count: int) -> None:
    """Wait until each topic has ``count`` subscribers; raises `RuntimeError` after 20 s."""
    end = time.monotonic() + 20.0
    while any(len(hub.graph.subscriptions(topic)) != count for topic in topics):
        if time.monotonic() > end:
            subscribers = {
                topic: [subscription.node for subscription in hub.graph.subscriptions(topic)] for topic in topics
            }
            raise RuntimeError(f"not {count} subscribers of each topic: {subscribers}")
        time.sleep(0.05)


def picture() -> bytes:
    """Return an image in CDR: a gradient with noise in its lowest bits, like a camera's noise."""
    import numpy as np

    from bridge.messages.values import MessageWriter

    rows, columns = np.mgrid[0:SIDE, 0:SIDE]
    noise = np.random.default_rng(1).integers(0, 8, (SIDE, SIDE, 3))
    pixels = ((rows + columns)[:, :, None] // 10 + noise).astype(np.uint8)
    fields = {"height": SIDE, "width": SIDE, "encoding": "rgb8", "step": 3 * SIDE, "data": pixels.reshape(-1)}
    return bytes(MessageWriter(Registry().schema(IMAGE_TYPE)).message(fields))


# -- the processes -----------------------------------------------------------------------------------------------------


def send(endpoint: str, domain: int, flow: float) -> None:
    """For each input line with seconds, publish for that time, and print the numbers of sent messages."""
    registry = Registry()
    image, small = picture(), bytes(100)
    image_rate = flow / len(image)
    with Hub.open(settings(endpoint, "sender", domain)) as hub:
        big = hub.publisher(IMAGE, IMAGE_TYPE, registry.ros2(IMAGE_TYPE).type_id, Qos(depth=100))
        few = [hub.publisher(t, SMALL_TYPE, registry.ros2(SMALL_TYPE).type_id, Qos(depth=1000)) for t in SMALL]
        send_line({"ready": True, "image": len(image)})
        for line in sys.stdin:
            seconds = float(line)
            begin = time.monotonic()
            images = smalls = 0
            while (now := time.monotonic() - begin) < seconds:
                while smalls < now * SMALL_RATE:
                    for publisher in few:
                        publisher.put(small)
                    smalls += 1
                if images < now * image_rate:
                    big.put(image)
                    images += 1
                time.sleep(0.0005)
            send_line({"images": images, "small": smalls * len(few), "seconds": time.monotonic() - begin})


def listen(endpoint: str, domain: int) -> None:
    """Subscribe to everything; at each input line print the latencies of the small messages (ms), and clear them."""
    registry = Registry()
    ages: list[int] = []
    images = [0]
    with Hub.open(settings(endpoint, "listener", domain)) as hub:
        kind = registry.ros2(SMALL_TYPE).type_id
        for topic in SMALL:
            hub.subscription(
                topic, SMALL_TYPE, kind, Qos(depth=1000), lambda s: ages.append(time.time_ns() - s.source_time_ns)
            )

        def image(_: Any) -> None:
            images[0] += 1

        hub.subscription(IMAGE, IMAGE_TYPE, registry.ros2(IMAGE_TYPE).type_id, Qos(depth=10), image)
        send_line({"ready": True})
        for _ in sys.stdin:
            latencies = sorted(ages)
            ages.clear()
            share = {name: latencies[int(len(latencies) * part)] / 1e6 for name, part in (("p50", 0.5), ("p99", 0.99))}
            send_line({**share, "received": len(latencies), "images": images[0]})
            images[0] = 0


def bare(endpoint: str, file: Path, compression: str) -> None:
    """Subscribe with bare zenoh, and write with `mcap` on another thread, until the input ends.

    Writing in zenoh's callback would block the sender, which would then send less.
    """
    import zenoh
    from mcap.writer import CompressionType, Writer

    from bridge.hub.wire.keys import unpack_attachment
    from bridge.hub.zenoh_config import MAX_PAYLOAD, make_config, session_tree
    from bridge.messages.definitions.text import full_text

    registry = Registry()
    config = make_config(session_tree(endpoint, shared_memory=True, max_payload=MAX_PAYLOAD), None)
    with file.open("wb") as stream, zenoh.open(config) as session:
        writer = Writer(stream, compression=CompressionType[compression.upper()])
        writer.start("ros2")
        queue: SimpleQueue[tuple[int, int, bytes, int, int] | None] = SimpleQueue()
        subscribers = []
        for topic, kind in [(IMAGE, IMAGE_TYPE), *((topic, SMALL_TYPE) for topic in SMALL)]:
            schema = writer.register_schema(kind, "ros2msg", full_text(registry.schema(kind)).encode())
            channel = writer.register_channel(topic, "cdr", schema)

            def on_sample(sample: zenoh.Sample, channel: int = channel) -> None:
                now = time.time_ns()
                assert sample.attachment is not None
                sequence, sent, _ = unpack_attachment(sample.attachment.to_bytes())
                queue.put((channel, now, sample.payload.to_bytes(), sent, sequence))

            handler = zenoh.handlers.Callback(on_sample, indirect=False)
            subscribers.append(session.declare_subscriber(f"0{topic}/**", handler))
        send_line({"ready": True})

        def until_the_end() -> None:
            sys.stdin.read()
            queue.put(None)

        Thread(target=until_the_end, daemon=True).start()
        while (message := queue.get()) is not None:
            writer.add_message(*message)
        for subscriber in subscribers:
            subscriber.undeclare()  # type: ignore[no-untyped-call]
        writer.finish()  # type: ignore[no-untyped-call]


def send_line(message: dict[str, Any]) -> None:
    """Print a line of JSON for the benchmark."""
    print(json.dumps(message), flush=True)


# -- the turns ---------------------------------------------------------------------------------------------------------


class Program:
    """A process that reads lines from standard input and writes lines to standard output."""

    def __init__(self, *words: str | Path) -> None:
        self._name = " ".join(map(str, words))
        self.process = subprocess.Popen(
            [sys.executable, *map(str, words)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT,
            env={**os.environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"},
        )  # fmt: skip

    def receive(self) -> dict[str, Any]:
        """Return the next line; raises `RuntimeError` if the process has exited."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError(f"{self._name} has exited")
        message: dict[str, Any] = json.loads(line)
        return message

    def send(self, line: str) -> None:
        """Send a line to the process."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()

    def cpu(self) -> float:
        """Return the processor seconds so far."""
        times = psutil.Process(self.process.pid).cpu_times()
        return float(times.user + times.system)

    def cpu_at_rest(self) -> float:
        """Return the processor seconds once the process is idle, because then everything is written."""
        before, now = -1.0, self.cpu()
        while now - before > 0.05:
            Event().wait(0.5)
            before, now = now, self.cpu()
        return now

    def end(self) -> None:
        """Let the process exit, by the end of its input and Ctrl-C."""
        if self.process.poll() is None:
            assert self.process.stdin is not None
            self.process.stdin.close()
            self.process.send_signal(signal.SIGINT)
        try:
            self.process.wait(30)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()


class Turn(NamedTuple):
    """One turn's figures.

    ``cpu``: the recorder's processor seconds per GB of images; ``lost``: messages missing in the file; ``p50``,
    ``p99``: latency of the small messages, ms; ``megabytes`` of images, and ``small`` messages, sent per second.
    """

    cpu: float
    lost: int
    p50: float
    p99: float
    megabytes: float
    small: float


@contextlib.contextmanager
def running(*words: str | Path) -> Iterator[Program]:
    """Run a program until the end of the context."""
    program = Program(*words)
    try:
        yield program
    finally:
        program.end()


class Bench:
    """The hub, the sender and the listener; recorders run in turns."""

    def __init__(self, args: argparse.Namespace, stack: contextlib.ExitStack) -> None:
        from tests.support.ports import free_port

        folder = args.folder or (Path("/dev/shm") if Path("/dev/shm").is_dir() else None)
        self.folder = Path(stack.enter_context(tempfile.TemporaryDirectory(dir=folder)))
        self.args, self.endpoint = args, f"tcp/127.0.0.1:{free_port()}"
        self.config = self.folder / "midspan.yaml"
        self.config.write_text(
            f"name: bench\nstate: {self.folder / 'state'}\nhub: {{listen: '{self.endpoint}', lane: false}}\n"
        )
        stack.enter_context(running("-m", "bridge.cli.main", "worker", "router", "--config", self.config))
        self.watch = stack.enter_context(Hub.open(settings(self.endpoint, "watch")))
        self.listener = stack.enter_context(running(__file__, "--role", "listen", "--endpoint", self.endpoint))
        self.sender = stack.enter_context(
            running(__file__, "--role", "send", "--endpoint", self.endpoint, "--flow", str(args.flow))
        )
        self.listener.receive()
        self.image = self.sender.receive()["image"]

    def turn(self, recorder: str) -> Turn:
        """Run one turn with a recorder."""
        file = self.folder / "turn.mcap"
        with contextlib.ExitStack() as stack:
            program = None
            if recorder != "nobody":
                program = stack.enter_context(running(*self._command(recorder, file)))
            until_subscribed(self.watch, [IMAGE, *SMALL], 2 if recorder == "midspan" else 1)
            if recorder == "bare":
                assert program is not None
                program.receive()
            self._flow(1.0)  # links, caches and the first file's channels
            self.listener.send("forget")
            self.listener.receive()
            before = program.cpu() if program is not None else 0.0
            sent = self._flow(self.args.seconds)
            self.listener.send("tell")
            received = self.listener.receive()
            used = program.cpu_at_rest() - before if program is not None else 0.0
        lost = self._lost(file) if program is not None else 0
        file.unlink(missing_ok=True)
        duration = sent["seconds"]
        megabytes, small = sent["images"] * self.image / duration / 1e6, sent["small"] / duration
        result = Turn(
            used / (sent["images"] * self.image / 1e9), lost, received["p50"], received["p99"], megabytes, small
        )
        print(f"{recorder:8} {result}", file=sys.stderr, flush=True)
        return result

    def _command(self, recorder: str, file: Path) -> list[str | Path]:
        how = self.args.compression
        if recorder == "bare":
            return [__file__, "--role", "bare", "--endpoint", self.endpoint, "--file", file, "--compression", how]
        return [
            "-m", "bridge.cli.main", "record", IMAGE, "/small_*", "-o", file, "--compression", how, "--queue", "512MB",
            "--config", self.config,
        ]  # fmt: skip

    def _flow(self, seconds: float) -> dict[str, Any]:
        """Let the sender send for a time, and wait `SETTLE_SECONDS` for the last messages."""
        self.sender.send(str(seconds))
        sent = self.sender.receive()
        Event().wait(SETTLE_SECONDS)
        return sent

    @staticmethod
    def _lost(file: Path) -> int:
        """Return the number of missing messages between the first and the last of each topic."""
        from mcap.records import Channel, Message
        from mcap.stream_reader import StreamReader

        spans: dict[int, tuple[int, int, int]] = {}
        topics: dict[int, str] = {}
        with file.open("rb") as stream:
            for record in StreamReader(stream, record_size_limit=None).records:
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, Message):
                    number = record.sequence
                    first, last, count = spans.get(record.channel_id, (number, number, 0))
                    spans[record.channel_id] = min(first, number), max(last, number), count + 1
        if set(topics.values()) != {IMAGE, *SMALL}:
            raise RuntimeError(f"the file contains {set(topics.values())}")
        return sum(last - first + 1 - count for first, last, count in spans.values())


def measure(args: argparse.Namespace) -> list[Row]:
    """Run all turns; return the medians as rows."""
    turns: dict[str, list[Turn]] = {name: [] for name in RECORDERS}
    with contextlib.ExitStack() as stack:
        bench = Bench(args, stack)
        for _ in range(args.rounds):
            for name in RECORDERS:
                turns[name].append(bench.turn(name))

    def middle(name: str, figure: str) -> float:
        return float(statistics.median(getattr(turn, figure) for turn in turns[name]))

    flow = middle("midspan", "megabytes"), middle("midspan", "small")
    print(f"sent with midspan: {flow[0]:.0f} MB/s of images, {flow[1]:.0f} small messages per second", file=sys.stderr)
    lost = {name: float(sum(turn.lost for turn in turns[name])) for name in RECORDERS}
    return [
        Row("sent images, with midspan, against bare", flow[0], middle("bare", "megabytes"), "MB/s", "more"),
        Row("messages lost", lost["midspan"], lost["bare"], "msgs"),
        Row(f"processor, {args.compression}, against bare", middle("midspan", "cpu"), middle("bare", "cpu"), "s/GB"),
        Row("latency p50 of small ones, against no recorder", middle("midspan", "p50"), middle("nobody", "p50"), "ms"),
        Row("latency p99 of small ones, against no recorder", middle("midspan", "p99"), middle("nobody", "p99"), "ms"),
        Row("latency p50 of small ones, against bare", middle("midspan", "p50"), middle("bare", "p50"), "ms"),
        Row("latency p99 of small ones, against bare", middle("midspan", "p99"), middle("bare", "p99"), "ms"),
    ]


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0, help="seconds of each turn (default 10)")
    parser.add_argument("--rounds", type=int, default=3, help="turns of each (default 3)")
    parser.add_argument("--flow", type=float, default=FLOW, help="bytes per second of images (default 200e6)")
    parser.add_argument("--compression", choices=["zstd", "lz4", "none"], default="none")
    parser.add_argument("--folder", type=Path, help="folder for the files (default: memory)")
    add_json_option(parser)
    inner = parser.add_argument_group("for its own processes")
    inner.add_argument("--role", choices=["send", "listen", "bare"])
    inner.add_argument("--endpoint")
    inner.add_argument("--domain", type=int, default=0)
    inner.add_argument("--file", type=Path)
    args = parser.parse_args(argv)
    if args.role is None:
        report(measure(args), args.json)
        return
    # Ctrl-C ends the benchmark, which stops its processes in order
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if args.role == "send":
        send(args.endpoint, args.domain, args.flow)
    elif args.role == "listen":
        listen(args.endpoint, args.domain)
    else:
        bare(args.endpoint, args.file, args.compression)


if __name__ == "__main__":
    main()
