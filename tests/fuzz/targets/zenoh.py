"""zenoh's key dialects: tokens and beacons of other bridges, and JSON on plain keys."""

from __future__ import annotations

import json
import time
from types import SimpleNamespace
from typing import Any

from bridge.hub.errors import HubWireError
from bridge.messages.errors import ConversionError
from tests.fuzz.target import JSON_WORDS, Subject, Target, texts

_ZID = "8b20917502ee955ac4476e0266340d5c"
_PUBLISHER = f"@/{_ZID}/@ros2_lv/MP/robot1§scan/sensor_msgs§msg§LaserScan/:1:0:0,10:typehash=RIHS01_{'ab' * 32};"
_SUBSCRIBER = f"@/{_ZID}/@ros2_lv/MS/tf_static/tf2_msgs§msg§TFMessage/K::1:1,1"
_TOKENS = texts(_PUBLISHER, _SUBSCRIBER, f"@/{_ZID}/@ros2_lv", f"@/{_ZID}/@ros2_lv/SS/add/a§srv§B")
_TOKEN_WORDS = texts(
    "§", "/", "//", "MP", "MS", "SS", "AC", "@ros2_lv", ":", ",", ";", "typehash=", "RIHS01_", "**", "*", "$*", "#",
    "-1", "2147483648",
    "\u0663", "1_0", " 1", "K", "\x00", "@/", "6d7370616e7a",
)  # fmt: skip
_BEACON = "ros1_discovery_info/*/pub/7374645f6d7367732f537472696e67/992ce8a1687cec8c8bd883ec73ca41d1/*/chatter"
_BEACON_WORDS = texts(
    "*", "/", "//", "pub", "sub", "srv", "cl", "ros1_discovery_info", "ff", "2f", " ", "@", "#", "x" * 32, "**"
)


def _ros2dds_token() -> Subject:
    """Tokens of zenoh-plugin-ros2dds; a parsed one is written as a token that parses to the same."""
    from bridge.adapters.zenoh.ros2dds_tokens import action_key, token_key
    from bridge.adapters.zenoh.ros2dds_tokens import parse as read

    def parse(data: bytes) -> None:
        parsed = read(data.decode(errors="replace"))
        write = action_key if len(parsed) > 1 else token_key
        assert not parsed or read(write(parsed[0])) == parsed

    return Subject(parse, _TOKENS, (HubWireError,), _TOKEN_WORDS)


def _ros2dds_graph() -> Subject:
    """Additions and removals of these tokens, one per line (``-`` removes); in the end the graph is empty."""
    import zenoh

    from bridge.adapters.zenoh.ros2dds_graph import Ros2ddsGraph

    put, delete = zenoh.SampleKind.PUT, zenoh.SampleKind.DELETE

    def parse(data: bytes) -> None:
        graph = Ros2ddsGraph(_Nothing(), "robot1/", lambda: None)  # type: ignore[arg-type]
        # zenoh's keys begin with the subscribed prefix
        lines = [line for line in data.decode(errors="replace").split("\n") if line.lstrip("-").startswith("@/")]
        for line in lines:
            kind = delete if line.startswith("-") else put
            graph._on_token(SimpleNamespace(key_expr=line.lstrip("-"), kind=kind))  # type: ignore[arg-type]
        assert all(endpoint.topic.startswith("/") for endpoint in graph.endpoints())
        for line in lines:
            graph._on_token(SimpleNamespace(key_expr=line.lstrip("-"), kind=delete))  # type: ignore[arg-type]
        left = (graph._tokens, graph._publishers, graph._bridges)
        assert not any(left), left

    seeds = [b"\n".join(_TOKENS), b"\n".join([*_TOKENS, b"-" + _TOKENS[0], _TOKENS[0], b"-" + _TOKENS[1]])]
    return Subject(parse, seeds, (), [*_TOKEN_WORDS, *texts("\n@/", "\n-@/", "-")])


class _Nothing:
    """A session and its objects, all of which do nothing."""

    def __getattr__(self, _name: str) -> Any:
        return lambda *_args, **_more: self

    def __str__(self) -> str:
        return "0"


def _ros1_beacon() -> Subject:
    """Discovery keys of zenoh-plugin-ros1; parsed ones are written as an equivalent key."""
    from bridge.adapters.zenoh.ros1_discovery import discovery_key
    from bridge.adapters.zenoh.ros1_discovery import parse as read

    def parse(data: bytes) -> None:
        kind, topic = read(data.decode(errors="replace"))
        again = read(discovery_key(kind, topic, "*"))
        assert again[0] is kind
        assert again[1].name.strip("/") == topic.name.strip("/")

    return Subject(parse, texts(_BEACON, _BEACON.replace("/pub/", "/srv/")), (HubWireError,), _BEACON_WORDS)


def _ros1_beacons() -> Subject:
    """Discovery keys of zenoh-plugin-ros1, one per line, and then silence, after which the graph is empty."""
    import zenoh

    from bridge.adapters.zenoh.ros1_discovery import _LOST, PERIOD, Aloha

    put = zenoh.SampleKind.PUT

    def parse(data: bytes) -> None:
        aloha = Aloha(_Nothing(), "*", lambda: None, lambda _name, _first: None)  # type: ignore[arg-type]
        for line in data.decode(errors="replace").split("\n"):
            aloha._on_beacon(SimpleNamespace(key_expr=line, kind=put, source_info=None, timestamp=None))  # type: ignore[arg-type]
        assert len(aloha.topics()) <= data.count(b"\n") + 1
        now = time.monotonic()
        for step in range(2 * _LOST + 2):  # in steps: while the process is suspended, silence does not count
            aloha.tick(now + step * PERIOD)
        assert aloha.topics() == []

    return Subject(parse, texts(f"{_BEACON}\n{_BEACON.replace('/pub/', '/sub/')}"), (), [*_BEACON_WORDS, b"\n"])


def _json_key() -> Subject:
    """JSON texts on plain keys; accepted ones are converted back to equivalent JSON."""
    from bridge.adapters.zenoh.json_keys import cdr_to_text, text_to_cdr
    from bridge.messages.registry import Registry
    from tests.messages.samples import sample

    registry = Registry()
    names = ("geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/JointState", "std_msgs/msg/UInt8MultiArray")
    conversions = [(text_to_cdr(registry, name), cdr_to_text(registry, name)) for name in names]

    def parse(data: bytes) -> None:
        to_cdr, to_json = conversions[data[0] % len(conversions) if data else 0]
        cdr = to_cdr(data[1:])
        assert to_cdr(to_json(cdr)) == cdr

    seeds = [bytes([k]) + json.dumps(sample(registry.schema(name))).encode() for k, name in enumerate(names)]
    tokens = [*JSON_WORDS, b"Infinity", b'"NaN"', b'"AAECAw=="', b'"header":', b"1.0", b"\xff"]
    return Subject(parse, seeds, (ConversionError,), tokens, 2048)


TARGETS = (
    Target("ros2dds_token", 20_000, _ros2dds_token),
    Target("ros2dds_graph", 5_000, _ros2dds_graph),
    Target("ros1_beacon", 15_000, _ros1_beacon),
    Target("ros1_beacons", 5_000, _ros1_beacons),
    Target("json_key", 5_000, _json_key),
)
