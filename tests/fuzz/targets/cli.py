"""The commands: messages that a user types, and documents that anybody on the hub may answer with."""

from __future__ import annotations

import json

from bridge.cli.errors import CliError
from bridge.messages.errors import ConversionError
from tests.fuzz.target import JSON_WORDS, Subject, Target, texts


def _pub() -> Subject:
    """The fields of ``midspan topic pub``."""
    from bridge.cli.topic_pub import _fields
    from bridge.messages.json import from_json
    from bridge.messages.registry import Registry

    registry = Registry()

    def parse(data: bytes) -> None:
        from_json(registry, "geometry_msgs/msg/TwistStamped", _fields(data.decode(errors="replace")))

    seeds = texts(
        "{twist: {linear: {x: 0.2}}}", "header: {frame_id: map, stamp: {sec: 1}}\ntwist:\n  angular: {z: -1e-3}\n", "{}"
    )
    words = texts("{", "[", ": ", "&a ", "*a", "<<: ", "!!python/object:a ", "!!set {a}", "? {a: b}",
                  "{[a]: b}", "!!timestamp 2001-01-01",
    "? ", "- ", ".nan", "0o7",
                  "2001-12-14 21:59:43", "!!binary x", "'", '"', "| ", "~", "\t")  # fmt: skip
    return Subject(parse, seeds, (CliError, ConversionError), words, largest=512)


def _status() -> Subject:
    """Status documents of workers."""
    from rich.console import Console

    from bridge.cli.routes_table import routes_table

    console = Console(width=120, quiet=True)
    route = {
        "direction": "in", "topic": "/a", "hub_topic": "/b", "type": "std_msgs/msg/String", "priority": "stream",
        "state": "active",
        "messages": 3, "rate": 2.5, "age": 0.1, "latency_ms": {"p50": 0.2, "p99": 3},
        "drops": {"queue": 2}, "error": "x",
    }  # fmt: skip

    def parse(data: bytes) -> None:
        try:
            documents = json.loads(data)
        except (ValueError, RecursionError):
            return
        found = [d for d in documents if isinstance(d, dict)] if isinstance(documents, list) else []
        console.print(routes_table(found))

    seeds = [json.dumps([{"daemon": "robot", "side": "ros1", "routes": [route, route]}]).encode()]
    words = [*JSON_WORDS, *texts('"\\u001b[2J"', '"[red]"', '"routes":', '"drops":', '"error":')]
    return Subject(parse, seeds, (), words, largest=2048)


TARGETS = (
    Target("topic_pub", 700, _pub),
    Target("status", 1_500, _status),
)
