"""The command line: messages that a user types, and documents that anyone on the hub may reply with."""

from __future__ import annotations

import io
import json

from bridge.cli.output import CliError
from bridge.messages.errors import ConversionError
from tests.fuzz.target import JSON_WORDS, Subject, Target, texts


def _pub() -> Subject:
    """The message fields that a user types for ``midspan topic pub``."""
    from bridge.cli.messages import yaml_fields
    from bridge.messages.json import from_json
    from bridge.messages.registry import Registry

    registry = Registry()

    def parse(data: bytes) -> None:
        from_json(registry, "geometry_msgs/msg/TwistStamped", yaml_fields(data.decode(errors="replace")))

    seeds = texts(
        "{twist: {linear: {x: 0.2}}}", "header: {frame_id: map, stamp: {sec: 1}}\ntwist:\n  angular: {z: -1e-3}\n", "{}"
    )
    tokens = texts(
        "{", "[", ": ", "&a ", "*a", "<<: ", "!!python/object:a ", "!!set {a}", "? {a: b}", "{[a]: b}", "? ", "- ",
        ".nan", "!!timestamp 2001-01-01", "0o7", "2001-12-14 21:59:43", "!!binary x", "'", '"', "| ", "~", "\t",
    )  # fmt: skip
    return Subject(parse, seeds, (CliError, ConversionError), tokens, largest=512)


def _status() -> Subject:
    """Workers' status documents, printed as for a terminal."""
    from rich.console import Console

    from bridge.cli.inspection.status import show
    from bridge.client.status import document_of
    from bridge.hub.control import WorkerAnswer

    route = {
        "direction": "in", "topic": "/a", "hub_topic": "/b", "type": "std_msgs/msg/String", "priority": "stream",
        "state": "active", "messages": 3, "rate": 2.5, "age": 0.1, "latency_ms": {"p50": 0.2, "p99": 3},
        "drops": {"queue": 2}, "error": "x",
    }  # fmt: skip
    document = {
        "side": "ros1", "state": "running", "network": "n", "listen": "tcp/127.0.0.1:1", "sessions": 3, "uptime": 1.5,
        "cpu": 0.1, "rss": 7, "pid": 9, "error": "", "routes": [route, route], "warnings": ["w"],
        "refused": [{"direction": "in", "topic": "/t", "type": "a/A", "reason": "r", "cure": "c"}],
        "machines": [{"name": "m", "address": "a", "trusted": False}],
    }  # fmt: skip

    def parse(data: bytes) -> None:
        try:
            values = json.loads(data)
        except (ValueError, RecursionError):
            return
        console = Console(width=120, file=io.StringIO())
        show(
            console,
            [document_of(WorkerAnswer("robot", "ros1", v)) for v in (values if isinstance(values, list) else [])],
        )
        console.file.getvalue().encode()  # type: ignore[attr-defined]

    tokens = [*JSON_WORDS, *texts('"\\u001b[2J"', '"[red]"', '"routes":', '"drops":', '"error":')]
    return Subject(parse, [json.dumps([document]).encode()], (), tokens, largest=2048)


TARGETS = (
    Target("topic_pub", 700, _pub),
    Target("status", 1_500, _status),
)
