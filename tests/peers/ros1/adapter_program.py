"""A ROS 1 edge in the worker's environment, driven by JSON lines like the peers of `tests.peers.peer`.

Usage: adapter_program.py CONFIG STATE. Payloads are base64.
"""
# ruff: noqa: A002  # parameters are named as in the commands

from __future__ import annotations

import base64
import json
import logging
import os
import signal
import sys
import threading
import time
from collections import defaultdict
from pathlib import Path
from typing import IO, Any

from bridge.adapters.ros1.edge import Ros1Edge
from bridge.config.model import Config
from bridge.hub.endpoints.calls import CallError
from bridge.hub.graph.tokens import Origin
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import SideType


class Listener:
    """Counts the edge's notifications."""

    def __init__(self) -> None:
        self.changes = 0
        self.failures: list[str] = []

    def graph_changed(self) -> None:
        self.changes += 1

    def presence_changed(self) -> None:
        """Ignore it."""

    def message_refused(self, topic: str, reason: str, why: str) -> None:
        """Ignore it."""

    def edge_failed(self, reason: str) -> None:
        self.failures.append(reason)


class Inbox:
    """Records what a subscription delivers."""

    def __init__(self) -> None:
        self.messages: list[tuple[str, str, int]] = []
        self.ready = threading.Condition()
        self.handle: Any = None

    def deliver(self, payload: bytes, source: str, time_ns: int | None) -> None:
        assert time_ns is None
        with self.ready:
            self.messages.append((base64.b64encode(payload).decode(), source, time.time_ns()))
            self.ready.notify_all()

    def wait(self, count: int, seconds: float) -> list[tuple[str, str, int]]:
        with self.ready:
            self.ready.wait_for(lambda: len(self.messages) >= count, seconds)
            return list(self.messages)


class Calls:
    """Calls of a service, and their results."""

    def __init__(self, caller: Any) -> None:
        self.caller, self.ready = caller, threading.Condition()
        self.results: dict[int, list[str]] = defaultdict(list)
        self.abandons: dict[int, Any] = {}

    def begin(self, number: int, request: bytes) -> float:
        def done(result: bytes | CallError) -> None:
            failed = isinstance(result, CallError)
            text = f"error: {result}" if failed else base64.b64encode(bytes(result)).decode()
            with self.ready:
                self.results[number].append(text)
                self.ready.notify_all()

        begin = time.monotonic()
        self.abandons[number] = self.caller.call(request, done)
        return time.monotonic() - begin

    def wait(self, count: int, seconds: float) -> dict[int, list[str]]:
        with self.ready:
            self.ready.wait_for(lambda: len(self.results) >= count, seconds)
            return dict(self.results)


class Served:
    """A service of the edge; the test replies to its calls."""

    def __init__(self) -> None:
        self.calls: list[tuple[bytes, Any]] = []
        self.abandoned: set[int] = set()
        self.handle: Any = None

    def call(self, request: bytes, done: Any) -> Any:
        self.calls.append((request, done))
        number = len(self.calls) - 1
        return lambda: self.abandoned.add(number)


class Program:
    """Executes the commands."""

    def __init__(self, config: Config, state: Path) -> None:
        self.listener = Listener()
        self.registry = Registry()
        self.edge = Ros1Edge(config, self.registry, state)
        self.handles: dict[int, Any] = defaultdict()

    def add(self, handle: Any) -> dict[str, Any]:
        self.handles[len(self.handles) + 1] = handle
        return {"id": len(self.handles)}

    def side_type(self, type: str, md5: str = "", definition: str = "") -> SideType:
        return SideType(type, md5, definition) if md5 else self.registry.ros1(type)

    def service_type(self, type: str, md5: str = "") -> SideType:
        return SideType(type, md5 or self.registry.service_hub_to_ros1(type.replace("/", "/srv/")).side.type_id, "")

    def do_start(self) -> dict[str, Any]:
        begin = time.monotonic()
        self.edge.start(self.listener)
        return {"seconds": time.monotonic() - begin}

    def do_network(self) -> dict[str, Any]:
        network = self.edge.network()
        is_own = network is not None and self.edge.is_own_network(Origin("ros1", network, "other"))
        return {"network": network, "own": is_own, "ros2": self.edge.is_own_network(Origin("ros2", network or "", ""))}

    def do_endpoints(self) -> dict[str, Any]:
        return {
            "endpoints": [
                {
                    "id": e.id, "kind": e.kind.value, "topic": e.topic, "type": e.type, "latched": e.qos.latched,
                    "made_by": e.made_by.value, "node": e.node, "type_id": e.type_id, "definition": e.definition,
                }
                for e in self.edge.endpoints()
            ]
        }  # fmt: skip

    def do_subscribe(self, topic: str, **type: str) -> dict[str, Any]:
        inbox = Inbox()
        inbox.handle = self.edge.subscribe(topic, self.side_type(**type), Qos(), inbox.deliver)
        return self.add(inbox)

    def do_wait(self, id: int, count: int, seconds: float) -> dict[str, Any]:
        return {"messages": self.handles[id].wait(count, seconds)}

    def do_advertise(self, topic: str, latched: bool = False, depth: int = 10, **type: str) -> dict[str, Any]:
        qos = Qos(durability=Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE, depth=depth)
        return self.add(self.edge.advertise(topic, self.side_type(**type), qos))

    def do_send(self, id: int, payload: str, source: str = "a", repeat: int = 1) -> dict[str, Any]:
        data = base64.b64decode(payload)
        begin = time.monotonic()
        for _ in range(repeat):
            self.handles[id].send(data, source)
        return {"seconds": time.monotonic() - begin, "dropped": self.handles[id].dropped}

    def do_subscribers(self, id: int) -> dict[str, Any]:
        return {"count": len(self.handles[id]._publication.connections)}

    def do_connections(self) -> dict[str, Any]:
        infos = self.edge._book.bus_info()
        return {kind: [info[4] for info in infos if info[2] == kind[0]] for kind in ("in", "out")}

    def do_forget(self, id: int, source: str) -> dict[str, Any]:
        self.handles[id].drop_source(source)
        return {}

    def do_caller(self, service: str, **type: str) -> dict[str, Any]:
        return self.add(Calls(self.edge.caller(service, self.service_type(**type))))

    def do_begin(self, id: int, request: str, number: int = 0) -> dict[str, Any]:
        return {"seconds": self.handles[id].begin(number, base64.b64decode(request))}

    def do_results(self, id: int, count: int = 1, seconds: float = 40.0) -> dict[str, Any]:
        return {"results": {str(k): v for k, v in self.handles[id].wait(count, seconds).items()}}

    def do_abandon(self, id: int, number: int = 0) -> dict[str, Any]:
        self.handles[id].abandons[number]()
        return {}

    def do_close_caller(self, id: int) -> dict[str, Any]:
        self.handles[id].caller.close()
        return {}

    def do_serve(self, service: str, **type: str) -> dict[str, Any]:
        served = Served()
        served.handle = self.edge.serve(service, self.service_type(**type), served.call)
        return self.add(served)

    def do_calls(self, id: int) -> dict[str, Any]:
        served = self.handles[id]
        return {
            "requests": [base64.b64encode(request).decode() for request, _ in served.calls],
            "abandoned": sorted(served.abandoned),
        }

    def do_answer(self, id: int, number: int = 0, reply: str = "", error: str = "") -> dict[str, Any]:
        self.handles[id].calls[number][1](CallError(error) if error else base64.b64decode(reply))
        return {}

    def do_drop(self, id: int) -> dict[str, Any]:
        handle = self.handles[id]
        getattr(handle, "handle", handle).close()
        return {}

    def do_convert(self, type: str) -> dict[str, Any]:
        endpoint = next(e for e in self.edge.endpoints() if e.type == type)
        conversion = self.edge.to_hub(endpoint)
        back = self.edge.from_hub(conversion.target.name, conversion.target.type_id)
        return {"hub": conversion.target.name, "side": back.target.name, "md5": back.target.type_id}

    def do_names(self, hub: str, side: str) -> dict[str, Any]:
        return {"side": self.edge.side_name(hub), "hub": self.edge.hub_name(side)}

    def do_announce(self, record: str) -> dict[str, Any]:
        self.edge.announce(record.encode())
        return {}

    def do_sightings(self) -> dict[str, Any]:
        records = [s.record.decode() if s.record is not None else None for s in self.edge.sightings()]
        return {"records": records, "settled": self.edge.settled(time.monotonic() - 1.0)}

    def do_status(self) -> dict[str, Any]:
        return {
            "others": [p.as_dict() for p in self.edge.others()],
            "warnings": self.edge.warnings(),
            "failures": self.listener.failures,
            "changes": self.listener.changes,
            "held_cancels": sum(len(s._order._held) for s in self.edge._actions._served.values() if s._order),
            "threads": threading.active_count(),
            "descriptors": len(list(Path("/proc/self/fd").iterdir())),
        }

    def do_look(self, every: float) -> dict[str, Any]:
        """Read the master now, and from now on with this period in seconds."""
        self.edge._master._period = every
        self.edge._master.wake()
        return {}

    def do_stop_timer(self) -> dict[str, Any]:
        """Stop running delayed calls."""
        self.edge._timer.after = lambda *_: None  # type: ignore[method-assign]
        return {}

    def do_stop(self) -> dict[str, Any]:
        begin = time.monotonic()
        self.edge.stop()
        return {"seconds": time.monotonic() - begin}

    def do_exit(self) -> dict[str, Any]:
        return {}


def main() -> None:
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    logging.basicConfig(level=logging.INFO)
    program = Program(Config.model_validate_json(sys.argv[1]), Path(sys.argv[2]))
    try:
        serve(program, answers)
    finally:
        program.edge.stop()


def serve(program: Program, answers: IO[str]) -> None:
    for line in sys.stdin:
        command = json.loads(line)
        name = command.pop("do")
        try:
            answer = {"ok": True, **getattr(program, "do_" + name)(**command)}
        except Exception as err:
            logging.getLogger("program").exception("%s", name)
            answer = {"ok": False, "error": f"{type(err).__name__}: {err}"}
        answers.write(json.dumps(answer) + "\n")
        if name == "exit":
            break


main()
