"""A ROS 1 edge in the worker's environment, driven with JSON lines like the programs of `tests.peers.peer`.

Usage: adapter_program.py CONFIG STATE. Payloads are base64.
"""
# ruff: noqa: A002  # parameters are named as in the commands

from __future__ import annotations

import base64
import logging
import signal
import sys
import threading
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

from bridge.adapters.ros1.edge import Ros1Edge
from bridge.adapters.ros1.graph import master
from bridge.config.model import Config
from bridge.hub.endpoints.calls import CallError
from bridge.hub.graph.tokens import Origin
from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import SideType
from tests.peers.commands import Commands, Record, only_answers, serve
from tests.peers.listener import Listener


class Inbox(Record):
    """Records the messages that a subscription delivers."""

    handle: Any = None

    def deliver(self, payload: bytes, source: str, time_ns: int | None) -> None:
        assert time_ns is None
        self.add((base64.b64encode(payload).decode(), source, time.time_ns()))


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


class Program(Commands):
    """Executes the commands."""

    def __init__(self, config: Config, state: Path) -> None:
        self.listener = Listener()
        super().__init__()
        self.registry = Registry()
        self.edge = Ros1Edge(config, self.registry, state)

    def side_type(self, type: str, md5: str = "", definition: str = "") -> SideType:
        return SideType(type, md5, definition) if md5 else self.registry.ros1(type)

    def service_type(self, type: str, md5: str = "") -> SideType:
        return SideType(type, md5 or self.registry.service_hub_to_ros1(type.replace("/", "/srv/")).side.type_id, "")

    def start(self) -> dict[str, Any]:
        begin = time.monotonic()
        self.edge.start(self.listener)
        return {"seconds": time.monotonic() - begin}

    def network(self) -> dict[str, Any]:
        network = self.edge.network()
        is_own = network is not None and self.edge.is_own_network(Origin("ros1", network, "other"))
        return {"network": network, "own": is_own, "ros2": self.edge.is_own_network(Origin("ros2", network or "", ""))}

    def endpoints(self) -> dict[str, Any]:
        return {
            "endpoints": [
                {
                    "id": e.id, "kind": e.kind.value, "topic": e.topic, "type": e.type, "latched": e.qos.latched,
                    "made_by": e.made_by.value, "node": e.node, "type_id": e.type_id, "definition": e.definition,
                }
                for e in self.edge.endpoints()
            ]
        }  # fmt: skip

    def subscribe(self, topic: str, **type: str) -> dict[str, Any]:
        inbox = Inbox()
        inbox.handle = self.edge.subscribe(topic, self.side_type(**type), Qos(), inbox.deliver)
        return self.add(inbox)

    def advertise(self, topic: str, latched: bool = False, depth: int = 10, **type: str) -> dict[str, Any]:
        qos = Qos(durability=Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE, depth=depth)
        return self.add(self.edge.advertise(topic, self.side_type(**type), qos))

    def send(self, id: int, payload: str, source: str = "a", repeat: int = 1) -> dict[str, Any]:
        data = base64.b64decode(payload)
        begin = time.monotonic()
        for _ in range(repeat):
            self.parts[id].send(data, source)
        return {"seconds": time.monotonic() - begin, "dropped": self.parts[id].dropped}

    def subscribers(self, id: int) -> dict[str, Any]:
        return {"count": len(self.parts[id]._publication.connections)}

    def connections(self) -> dict[str, Any]:
        infos = self.edge._book.bus_info()
        return {kind: [info[4] for info in infos if info[2] == kind[0]] for kind in ("in", "out")}

    def held(self, topic: str) -> dict[str, Any]:
        """Return how many connections of probes to publishers of a topic are held for a subscription."""
        return {"count": sum(peer.topic == topic for peer in list(self.edge._topics.prober._held))}

    def forget(self, id: int, source: str) -> dict[str, Any]:
        self.parts[id].drop_source(source)
        return {}

    def caller(self, service: str, **type: str) -> dict[str, Any]:
        return self.add(Calls(self.edge.caller(service, self.service_type(**type))))

    def begin(self, id: int, request: str, number: int = 0) -> dict[str, Any]:
        return {"seconds": self.parts[id].begin(number, base64.b64decode(request))}

    def results(self, id: int, count: int = 1, seconds: float = 40.0) -> dict[str, Any]:
        return {"results": {str(k): v for k, v in self.parts[id].wait(count, seconds).items()}}

    def abandon(self, id: int, number: int = 0) -> dict[str, Any]:
        self.parts[id].abandons[number]()
        return {}

    def close_caller(self, id: int) -> dict[str, Any]:
        self.parts[id].caller.close()
        return {}

    def serve(self, service: str, **type: str) -> dict[str, Any]:
        served = Served()
        served.handle = self.edge.serve(service, self.service_type(**type), served.call)
        return self.add(served)

    def calls(self, id: int) -> dict[str, Any]:
        served = self.parts[id]
        return {
            "requests": [base64.b64encode(request).decode() for request, _ in served.calls],
            "abandoned": sorted(served.abandoned),
        }

    def answer(self, id: int, number: int = 0, reply: str = "", error: str = "") -> dict[str, Any]:
        self.parts[id].calls[number][1](CallError(error) if error else base64.b64decode(reply))
        return {}

    def drop(self, id: int) -> dict[str, Any]:
        handle = self.parts[id]
        getattr(handle, "handle", handle).close()
        return {}

    def convert(self, type: str) -> dict[str, Any]:
        endpoint = next(e for e in self.edge.endpoints() if e.type == type)
        conversion = self.edge.to_hub(endpoint)
        back = self.edge.from_hub(conversion.target.name, conversion.target.type_id)
        return {"hub": conversion.target.name, "side": back.target.name, "md5": back.target.type_id}

    def names(self, hub: str, side: str) -> dict[str, Any]:
        return {"side": self.edge.side_name(hub), "hub": self.edge.hub_name(side)}

    def announce(self, record: str) -> dict[str, Any]:
        self.edge.announce(record.encode())
        return {}

    def sightings(self) -> dict[str, Any]:
        records = [s.record.decode() if s.record is not None else None for s in self.edge.sightings()]
        return {"records": records, "settled": self.edge.settled(time.monotonic() - 1.0)}

    def status(self) -> dict[str, Any]:
        return {
            "others": [p.as_dict() for p in self.edge.others()],
            "warnings": self.edge.warnings(),
            "failures": self.listener.failures,
            "changes": self.listener.changes,
            "held_cancels": sum(len(s._order._held) for s in self.edge._actions._served.values() if s._order),
            "threads": threading.active_count(),
            "descriptors": len(list(Path("/proc/self/fd").iterdir())),
        }

    def set_period(self, every: float) -> dict[str, Any]:
        """Read the master now, and from then on with this period in seconds."""
        self.edge._master._period = every
        self.edge._master.wake()
        return {}

    def stop_timer(self) -> dict[str, Any]:
        """Prevent delayed calls from being made."""
        self.edge._timer.after = lambda *_: None  # type: ignore[method-assign]
        return {}

    def stop(self, patience: float | None = None) -> dict[str, Any]:
        """Stop; a master that does not respond within ``patience`` seconds keeps the registrations."""
        if patience is not None:
            master._STOP_TIMEOUT = patience
        begin = time.monotonic()
        self.edge.stop()
        return {"seconds": time.monotonic() - begin}


def main() -> None:
    answers = only_answers()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    logging.basicConfig(level=logging.INFO)
    program = Program(Config.model_validate_json(sys.argv[1]), Path(sys.argv[2]))
    try:
        serve(program, answers)
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # would end the clean-up, and leave registrations behind
        program.edge.stop()


main()
