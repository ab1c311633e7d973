"""The cost of the server for the Foxglove app: processor time and memory with one client, compared with a bare relay.

The relay is a zenoh subscriber that passes each payload to a channel of the same SDK, and nothing else: no definitions,
no hub, no check of clients. Publisher, relay and client are separate processes of this file, started with ``--role``;
the router and the server are Midspan's workers.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import psutil
import yaml

from benchmarks.rows import Row, add_json_option, report
from bridge.hub.node import Hub
from bridge.hub.session import HubSettings
from bridge.hub.wire.qos import Qos
from bridge.hub.zenoh_config import MAX_PAYLOAD, make_config, session_tree
from bridge.messages.registry import Registry

CASES = {"images of 1 MB at 10 Hz": (1_000_000, 10.0), "1,000 messages of 100 B per second": (100, 1000.0)}
TOPIC, TYPE = "/bench", "std_msgs/msg/String"
PROTOCOL = "foxglove.sdk.v1"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark, or one of its other processes."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=8.0, help="seconds of each measurement (default 8)")
    parser.add_argument("--rounds", type=int, default=3, help="rounds of Midspan and the relay in turns (default 3)")
    parser.add_argument("--role", nargs="+", help=argparse.SUPPRESS)
    add_json_option(parser)
    args = parser.parse_args(arguments)
    if args.role:
        ROLES[args.role[0]](*args.role[1:])
        return 0
    report(measure(args.seconds, args.rounds), args.json)
    return 0


def measure(seconds: float, rounds: int) -> list[Row]:
    """Measure all cases, and return the rows."""
    rows: list[Row] = []
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        router, port = f"tcp/127.0.0.1:{free_port()}", free_port()
        config = folder / "midspan.yaml"
        config.write_text(
            yaml.safe_dump({
                "name": "bench", "state": str(folder), "hub": {"listen": router},
                "foxglove": {"enabled": True, "listen": f"127.0.0.1:{port}"},
            })
        )  # fmt: skip
        for worker in ("router", "foxglove"):
            command = ["-m", "bridge.cli.main", "worker", worker, "--config", str(config)]
            ours = stack.enter_context(running(command))
            until_listening(int(router.rpartition(":")[2]) if worker == "router" else port)
        rows.append(Row("memory without clients (PSS)", pss(ours), 0.0, "MB"))
        for case, (size, rate) in CASES.items():
            with running(role("publish", router, size, rate), "ready"):
                rows.append(Row(f"idle with {case}", cpu(ours, seconds), 0.0, "%"))
                loads: dict[str, list[float]] = {"ours": [], "relay": []}
                for _ in range(rounds):
                    with running(role("client", port), "receiving"):
                        loads["ours"].append(cpu(ours, seconds))
                        memory = pss(ours)
                    with (
                        running(role("relay", router), "port") as bare,
                        running(role("client", bare.ready_line.split()[-1]), "receiving"),
                    ):
                        loads["relay"].append(cpu(bare, seconds))
                        bare_memory = pss(bare)
                rows.append(Row(f"processor, {case}", median(loads["ours"]), median(loads["relay"]), "%"))
                rows.append(Row(f"memory (PSS), {case}", memory, bare_memory, "MB"))
    return rows


def median(values: Sequence[float]) -> float:
    """Return the median; if the number of values is even, the higher of the middle two."""
    return sorted(values)[len(values) // 2]


def free_port() -> int:
    """Return a free port of loopback."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def until_listening(port: int) -> None:
    """Wait until a server accepts connections; raises `TimeoutError` if it does not in time."""
    end = time.monotonic() + 30.0
    while time.monotonic() < end:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1.0):
            return
        time.sleep(0.05)
    raise TimeoutError(f"no server on port {port}")


class Program:
    """A process, and the line with which the process reported that it is ready."""

    def __init__(self, command: Sequence[str], ready: str) -> None:
        """Start the process, and wait for a line that contains ``ready``, unless ``ready`` is ""."""
        self.popen = subprocess.Popen(
            [sys.executable, *command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        self.process, self.ready_line = psutil.Process(self.popen.pid), ""
        assert self.popen.stdout is not None
        for line in self.popen.stdout if ready else ():
            self.ready_line = line.strip()
            if ready in line:
                break
        if ready not in self.ready_line:
            raise RuntimeError(f"{command} ended: {self.ready_line}")
        threading.Thread(target=self.popen.stdout.read, daemon=True).start()


@contextmanager
def running(command: Sequence[str], ready: str = "") -> Iterator[Program]:
    """Run a process until the end of the context."""
    program = Program(command, ready)
    try:
        yield program
    finally:
        program.popen.send_signal(signal.SIGTERM)
        try:
            program.popen.wait(10)
        except subprocess.TimeoutExpired:
            program.popen.kill()
            program.popen.wait()


def role(*arguments: object) -> list[str]:
    """Return the command of one of this file's processes."""
    return ["-m", "benchmarks.foxglove_cost", "--role", *map(str, arguments)]


def cpu(program: Program, seconds: float) -> float:
    """Measure a process's load, in percent of a core."""
    before = program.process.cpu_times()
    time.sleep(seconds)
    after = program.process.cpu_times()
    return 100.0 * (after.user + after.system - before.user - before.system) / seconds


def pss(program: Program) -> float:
    """Return a process's PSS, in megabytes."""
    return float(program.process.memory_full_info().pss) / 1e6


def publish(router: str, size: str, rate: str) -> None:
    """Publish until SIGTERM."""
    data = b"\0\1\0\0" + (int(size) - 8).to_bytes(4, "little") + bytes(int(size) - 8)
    with Hub.open(HubSettings(router=router, node="bench", worker="bench")) as hub:
        publisher = hub.publisher(TOPIC, TYPE, Registry().ros2(TYPE).type_id, Qos())
        print("ready", flush=True)
        due = time.monotonic()
        while True:
            publisher.put(data)
            due += 1.0 / float(rate)
            time.sleep(max(due - time.monotonic(), 0.0))


def relay(router: str) -> None:
    """Pass the topic's payloads to the SDK until SIGTERM."""
    import foxglove
    import zenoh

    server = foxglove.start_server(port=0)
    schema = foxglove.Schema(name=TYPE, encoding="ros2msg", data=b"string data\n")
    channel = foxglove.Channel(TOPIC, message_encoding="cdr", schema=schema)
    tree = session_tree(router, shared_memory=True, max_payload=MAX_PAYLOAD)
    with zenoh.open(make_config(tree, None)) as session:
        on_sample: Any = zenoh.handlers.Callback(lambda sample: channel.log(sample.payload.to_bytes()), indirect=False)
        session.declare_subscriber(f"0{TOPIC}/**", on_sample)
        print("port", server.port, flush=True)
        signal.pause()


def client(port: str) -> None:
    """Subscribe to the topic, and read its messages until SIGTERM."""
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    options: dict[str, Any] = {"max_size": None, "compression": None}
    with connect(f"ws://127.0.0.1:{port}", subprotocols=[Subprotocol(PROTOCOL)], **options) as app:
        count = 0
        while True:
            frame = app.recv()
            if isinstance(frame, str):
                message = json.loads(frame)
                for channel in message.get("channels", ()):
                    if channel["topic"] == TOPIC:
                        app.send(
                            json.dumps({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": channel["id"]}]})
                        )
                continue
            count += 1
            if count == 10:
                print("receiving", flush=True)


ROLES: dict[str, Callable[..., None]] = {"publish": publish, "relay": relay, "client": client}

if __name__ == "__main__":
    raise SystemExit(main())
