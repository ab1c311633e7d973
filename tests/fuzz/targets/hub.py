"""The hub: attachments, tokens, names, QoS, samples and control requests from anyone on the network."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from bridge.hub.errors import HubError, HubWireError
from tests.fuzz.target import JSON_WORDS, Subject, Target, texts

_NODE = "@ros2_lv/0/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener"
_ENDPOINT = (
    "@ros2_lv/0/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter/std_msgs::msg::dds_::String_/RIHS01_"
    + "ab" * 32
    + "/::,7:,:,:,,"
)
_ORIGIN = "@midspan/0/origin/aac3178e146ba6f1fc6e6a4085e77f21/ros1/run%2Did/robot"
_TOKEN_WORDS = texts(
    "/", "%", "//", "@ros2_lv", "@midspan", "/NN/", "/MS/", "/SS/", "/SC/", "origin", "**", "*", "#", "?", "$*",
    "%00", "%ff", ":", ",",
    "::dds_::", "_/", "RIHS01_", "%midspan", "0", "00000", "99999", "\x00", "\u0663", "2:1:2,1:1,2:3,4:1,1,1",
)  # fmt: skip


def _attachment() -> Subject:
    """The attachment of a sample."""
    from bridge.hub.wire.keys import pack_attachment, unpack_attachment

    def parse(data: bytes) -> None:
        read = unpack_attachment(data)
        assert pack_attachment(*read) == data

    good = pack_attachment(1, 1_700_000_000_000_000_000, bytes(range(16)))
    return Subject(parse, [good, good[:-1], good + b"\0"], (HubWireError,), largest=64)


def _token() -> Subject:
    """Liveliness tokens of endpoints, nodes and origins; a parsed one, written and parsed again, is the same token."""
    from bridge.hub.graph.tokens import (
        NodeToken,
        endpoint_key,
        gid_of,
        node_key,
        origin_key,
        parse_origin,
        parse_token,
    )

    def parse(data: bytes) -> None:
        key = data.decode(errors="replace")
        gid_of(key)
        if key.startswith("@midspan"):
            origin = parse_origin(key)
            assert parse_origin(origin_key(origin)) == origin
            return
        token = parse_token(key)
        again = node_key(token) if isinstance(token, NodeToken) else endpoint_key(token)
        assert parse_token(again) == token, again

    return Subject(parse, texts(_NODE, _ENDPOINT, _ORIGIN), (HubWireError,), _TOKEN_WORDS)


def _graph() -> Subject:
    """The graph while tokens are added and removed, one per line (``-`` removes); in the end the graph is empty."""
    import zenoh

    from bridge.hub.graph import HubGraph

    class Nothing:
        """A session, its liveliness and its subscribers, all of which do nothing."""

        def __getattr__(self, _name: str) -> Any:
            return lambda *_args, **_more: self

    put, delete = zenoh.SampleKind.PUT, zenoh.SampleKind.DELETE

    def parse(data: bytes) -> None:
        graph = HubGraph(Nothing(), 0, 8)  # type: ignore[arg-type]
        keys = data.decode(errors="replace").split("\n")
        for line in keys:
            removed = line.startswith("-")
            graph._on_sample(SimpleNamespace(key_expr=line.lstrip("-"), kind=delete if removed else put))  # type: ignore[arg-type]
        assert len(graph.nodes()) + len(graph.endpoints()) <= 8
        for endpoint in graph.endpoints():
            graph.origin_of(endpoint.zid)
            assert endpoint in getattr(graph, f"{endpoint.kind}s")(endpoint.topic)
        for line in keys:
            graph._on_sample(SimpleNamespace(key_expr=line.lstrip("-"), kind=delete))  # type: ignore[arg-type]
        table, announced = graph._table, graph._announced
        left = (table._nodes, table._endpoints, table._topics, table._sessions, table.zids, table._bridged,
                announced.origins, announced._tokens)  # fmt: skip
        assert not any(left), left

    bridge = _ENDPOINT.replace("/MP/%/", "/MP/%midspan/")
    seeds = texts(
        f"{_NODE}\n{_ENDPOINT}\n{_ORIGIN}",
        f"{_ORIGIN}\n{bridge}\n-{_ORIGIN}\n{_ORIGIN}2\n-{bridge}",
        f"{_NODE}\n-{_NODE}",
    )
    return Subject(parse, seeds, (), [*_TOKEN_WORDS, *texts("\n", "-", "\n-")])


def _qos() -> Subject:
    """A QoS as text; a parsed one, written and parsed again, is the same QoS."""
    from bridge.hub.wire.qos import decode_qos, encode_qos

    def parse(data: bytes) -> None:
        qos = decode_qos(data.decode(errors="replace"))
        assert decode_qos(encode_qos(qos)) == qos

    seeds = texts("::,7:,:,:,,", "2:1:2,1:1,2:3,4:1,1,1", ":::::", "::,10:9223372036,854775807:,:,,")
    return Subject(
        parse,
        seeds,
        (HubWireError,),
        texts(":", ",", "0", "9223372036", "854775807", "4294967296", "\u0663", "-1"),
        200,
    )


def _names() -> Subject:
    """Topic names, type names and hashes; accepted ones are valid in a zenoh key."""
    import zenoh

    from bridge.hub.wire.keys import check_topic, dds_type_name, demangle, mangle, ros_type_name, topic_key

    def parse(data: bytes) -> None:
        topic, _, remainder = data.decode(errors="replace").partition(" ")
        type_name, _, type_hash = remainder.partition(" ")
        key = topic_key(0, topic, type_name, type_hash)
        assert ros_type_name(dds_type_name(type_name)) == type_name
        assert demangle(mangle(check_topic(topic))) == topic
        assert str(zenoh.KeyExpr(key)) == key

    seeds = texts(
        "/a/b std_msgs/msg/String RIHS01_" + "ab" * 32, "/a_b/c1 a/srv/B_Request RIHS01_0", "/\u00e9 a/msg/B_ RIHS01_1"
    )
    return Subject(parse, seeds, (HubWireError,), [*_TOKEN_WORDS, *texts(" ", "/msg/", "\n", "@", "/@adv")], 2000)


def _question() -> Subject:
    """Requests and replies of the control plane."""
    from bridge.hub.control import _params, _read

    def parse(data: bytes) -> None:
        payload = SimpleNamespace(to_bytes=lambda: data)
        answer = _read(SimpleNamespace(key_expr="@midspan/0/d/w/status", payload=payload))  # type: ignore[arg-type]
        assert isinstance(answer.error, str)
        assert isinstance(_params(SimpleNamespace(payload=_Sized(data))), dict)  # type: ignore[arg-type]

    seeds = texts('{"topic": "/a", "seconds": 3.5}', '{"value": {"routes": []}}', '{"error": "no"}', "{}")
    return Subject(parse, seeds, (HubError,), [*JSON_WORDS, *texts('"value":', '"error":')])


class _Sized:
    def __init__(self, data: bytes) -> None:
        self._data = data

    def __len__(self) -> int:
        return len(self._data)

    def to_bytes(self) -> bytes:
        return self._data


def _samples() -> Subject:
    """A subscription (latched if the first byte is ``1``) that receives samples of 34 bytes: attachment and action."""
    import zenoh

    from bridge.hub.endpoints import subscription as module
    from bridge.hub.endpoints.context import EndpointContext
    from bridge.hub.endpoints.latched_subscription import LatchedHubSubscription
    from bridge.hub.endpoints.subscription import HubSubscription
    from bridge.hub.wire.keys import NO_HASH, pack_attachment, topic_key
    from bridge.hub.wire.qos import Durability, Qos

    class Nothing:
        """A session, a graph and their objects, all of which do nothing."""

        def __getattr__(self, _name: str) -> Any:
            return lambda *_args, **_more: self

        def __str__(self) -> str:
            return "0"

    put, plain = zenoh.SampleKind.PUT, zenoh.Encoding.ZENOH_BYTES
    module.MAX_HELD_BYTES = 1000  # room for three samples

    def parse(data: bytes) -> None:
        received: list[Any] = []
        qos = Qos(durability=Durability.TRANSIENT_LOCAL if data[:1] == b"1" else Durability.VOLATILE, depth=5)
        some: Any = Nothing()
        key = topic_key(0, "/t", "std_msgs/msg/String", NO_HASH)
        context = EndpointContext(some, some, set(), some, 1000, some, some, some, some, some, lambda _closed: None)
        actions: dict[bytes, Any] = {}
        if qos.latched:
            latched = LatchedHubSubscription(context, "t", key, "/t", qos, received.append)
            actions = {
                b"c": latched.on_stored, b"d": lambda _: latched.done("0"), b"a": lambda _: latched.on_query("0"),
            }  # fmt: skip
            subscription: HubSubscription = latched
        else:
            subscription = HubSubscription(context, "t", key, "/t", received.append)
        count = 0
        for at in range(1, min(len(data), 1000), 34):
            attached, how = data[at : at + 33], data[at + 33 : at + 34]
            sample = SimpleNamespace(
                kind=put, payload=b"x", source_info=None, encoding=plain,
                attachment=SimpleNamespace(to_bytes=lambda a=attached: a),
            )  # fmt: skip
            count += 1
            actions.get(how, subscription._on_sample)(sample)
        assert len(received) <= count
        kept = [message for source in subscription.sources.values() for message in source.held.values()]
        assert subscription.sources.held_bytes == len(kept) * (1 + module.OVERHEAD) <= module.MAX_HELD_BYTES
        assert 0 <= subscription.lost <= 1_000_000 * count

    def encoded(sequence: int, time_ns: int, how: bytes = b".") -> bytes:
        return pack_attachment(sequence, time_ns, bytes(range(16))) + how

    seeds = [latched + b"".join(encoded(n, 10 + n) for n in (1, 2, 4, 3, 9)) for latched in (b"0", b"1")]
    seeds += [
        b"1" + encoded(1, 1, b"a") + encoded(2, 2, b"c") + encoded(1, 1, b"c") + encoded(3, 3) + encoded(3, 3, b"d")
    ]
    return Subject(parse, seeds, (), largest=1000)


TARGETS = (
    Target("attachment", 60_000, _attachment),
    Target("token", 40_000, _token),
    Target("hub_graph", 8_000, _graph),
    Target("qos", 30_000, _qos),
    Target("hub_names", 25_000, _names),
    Target("control", 15_000, _question),
    Target("samples", 6_000, _samples),
)
