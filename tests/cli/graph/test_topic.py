"""``midspan topic`` on a real hub with a real engine: topics that are bridged, and topics that stay on their side."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from bridge.hub.node import Hub
from bridge.hub.wire.qos import Qos
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from bridge.routing.edge import MadeBy
from tests.cli.conftest import Midspan
from tests.peers.daemon.workers import LATCHED, EngineWorker, FakeWorker
from tests.peers.fake import Writer
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until

STRING = "std_msgs/msg/String"
SCAN = "sensor_msgs/msg/LaserScan"


@pytest.fixture
def worker(network: HubNetwork, registry: Registry, closing: list[Any]) -> EngineWorker:
    engine_worker = EngineWorker(network, registry, rules=[{"topic": "/secret", "deny": True}])
    closing.append(engine_worker)
    return engine_worker


@contextmanager
def publishing(worker: EngineWorker, writer: Writer, cdr: bytes) -> Iterator[None]:
    """A native program on the side that publishes repeatedly."""
    stop = threading.Event()

    def talk() -> None:
        while not stop.wait(0.02):
            worker.side.write(writer, cdr)

    thread = threading.Thread(target=talk)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def wait_for_routes(worker: EngineWorker, count: int) -> None:
    until(lambda: len(worker.engine.routes()) == count, "all routes exist")


def test_list_shows_bridged_and_unbridged_topics(midspan: Midspan, worker: EngineWorker) -> None:
    for topic in ("/chatter", "/secret", "/rosout"):
        worker.advertise(topic, STRING)
    wait_for_routes(worker, 1)
    names = ["/chatter", "/rosout", "/secret"]
    until(lambda: midspan("topic", "list").out.split() == names, "the engine has decided on all topics")
    entries = {entry["topic"]: entry for entry in midspan("topic", "list", "--json").json()}
    assert {name: entry["state"] for name, entry in entries.items()} == {
        "/chatter": "hub",
        "/rosout": "private",
        "/secret": "denied",
    }
    assert entries["/chatter"]["from"] == ["ros1"]
    listing = midspan("topic", "list", "-v").out
    assert [line.split()[0] for line in listing.splitlines() if STRING in line] == ["/chatter", "/rosout", "/secret"]


def test_info_lists_publishers_and_subscribers(
    midspan: Midspan, worker: EngineWorker, network: HubNetwork, closing: list[Any]
) -> None:
    worker.advertise("/chatter", STRING, latched=True)
    wait_for_routes(worker, 1)
    listener = FakeWorker(network, "listener")
    closing.append(listener)
    listener.subscribe("/chatter", STRING, Qos(depth=7))
    output = midspan("topic", "info", "chatter").out
    document = midspan("topic", "info", "/chatter", "--json").json()
    for text in (
        "publishers on the hub: 1",
        "/midspan_ros1 (for ROS 1, daemon robot1)",
        "/midspan_listener (zenoh",
        "volatile 7",
    ):
        assert text in output
    assert [e["side"] for e in document["publishers"]] == ["ros1"]
    assert document["publishers"][0]["qos"].startswith("reliable transient_local")
    unknown = midspan("topic", "info", "/chater")
    assert (unknown.code, "/chatter" in unknown.err) == (1, True)


def test_echo_prints_latched_messages_at_once(midspan: Midspan, worker: EngineWorker, registry: Registry) -> None:
    cdr = from_json(registry, SCAN, {"header": {"frame_id": "laser"}, "ranges": [1.5] * 100})
    worker.side.write(worker.advertise("/scan", SCAN, latched=True), cdr)
    wait_for_routes(worker, 1)
    output = midspan("topic", "echo", "/scan", "--count", "1", "--timeout", "10").out
    assert "frame_id: laser" in output
    assert "ranges: [1.5, 1.5" in output
    assert "(100 in all)" in output
    assert output.endswith("---\n")
    full = midspan("topic", "echo", "/scan", "--count", "1", "--timeout", "10", "--full").out
    assert full.count("1.5") == 100
    (line,) = midspan("topic", "echo", "/scan", "--count", "1", "--timeout", "10", "--json").lines()
    assert (line["type"], line["side"], len(line["message"]["ranges"])) == (SCAN, "ros1", 100)
    raw = midspan("topic", "echo", "/scan", "--count", "1", "--timeout", "10", "--raw").out
    assert bytes.fromhex(raw.strip()) == cdr


@pytest.mark.parametrize("topic", ["/rosout", "/secret"])
def test_echo_prints_an_unbridged_topic(midspan: Midspan, worker: EngineWorker, registry: Registry, topic: str) -> None:
    writer = worker.advertise(topic, STRING)
    until(lambda: len(worker.engine.decisions()) == 1, "the engine has decided on the topic")
    with publishing(worker, writer, from_json(registry, STRING, {"data": "hidden"})):
        done = midspan("topic", "echo", topic, "--count", "2", "--timeout", "10")
    assert (done.code, done.out.count("data: hidden")) == (0, 2), done
    assert midspan("topic", "list").out.split() == [topic]


def test_echo_with_a_side_prints_that_sides_messages(
    midspan: Midspan, worker: EngineWorker, network: HubNetwork, registry: Registry
) -> None:
    writer = worker.advertise("/chatter", STRING)
    wait_for_routes(worker, 1)
    type_hash = registry.ros2(STRING).type_id
    with Hub.open(network.settings("native")) as hub:
        publisher = hub.publisher("/chatter", STRING, type_hash, LATCHED)
        publisher.put(from_json(registry, STRING, {"data": "from the hub"}))
        with publishing(worker, writer, from_json(registry, STRING, {"data": "from the side"})):
            sides = {}
            for side in ("ros1", "zenoh"):
                args = ("topic", "echo", "/chatter", "--side", side, "--count", "1", "--timeout", "10", "--json")
                sides[side] = midspan(*args).lines()[0]["message"]["data"]
    assert sides == {"ros1": "from the side", "zenoh": "from the hub"}


def test_echo_suggests_a_similar_topic_and_times_out_without_messages(midspan: Midspan, worker: EngineWorker) -> None:
    worker.advertise("/chatter", STRING)
    wait_for_routes(worker, 1)
    done = midspan("topic", "echo", "/chattr")
    assert (done.code, "Did you mean /chatter?" in done.err) == (1, True), done
    done = midspan("topic", "echo", "/chatter", "--timeout", "0.3")
    assert (done.code, "no message of /chatter for 0.3 s" in done.err) == (1, True), done


def test_echo_requests_unknown_types_from_the_workers(
    midspan: Midspan, network: HubNetwork, closing: list[Any]
) -> None:
    name = "odd_msgs/msg/Odd"
    known = Registry()
    known.learn_ros2(name, "float64 weight\nstring label\n")
    odd = known.ros2(name)
    type_answer = {"name": name, "hash": odd.type_id, "definition": odd.definition}
    type_worker = FakeWorker(network, "ros1", type=lambda params: type_answer if params["name"] == name else {})
    closing.append(type_worker)
    type_worker.publish("/odd", name, odd.type_id, from_json(known, name, {"weight": 2.5, "label": "x"}))
    (line,) = midspan("topic", "echo", "/odd", "--count", "1", "--timeout", "10", "--json").lines()
    assert line["message"] == {"weight": 2.5, "label": "x"}

    type_worker.publish("/other", name, "RIHS01_" + "5" * 64, b"\0\1\0\0")
    done = midspan("topic", "echo", "/other", "--count", "1", "--timeout", "10")
    assert (done.code, name in done.err) == (1, True), done


def test_echo_continues_after_a_bad_message(midspan: Midspan, network: HubNetwork, closing: list[Any]) -> None:
    maker = FakeWorker(network, "native")
    closing.append(maker)
    type_hash = Registry().ros2(STRING).type_id
    maker.publish("/bad", STRING, type_hash, b"\0\1\0\0\xff\xff")
    done = midspan("topic", "echo", "/bad", "--count", "1", "--timeout", "10")
    assert (done.code, done.out.startswith("# ")) == (0, True), done


def test_hz_measures_the_rate(midspan: Midspan, worker: EngineWorker, registry: Registry) -> None:
    writer = worker.advertise("/chatter", STRING)
    wait_for_routes(worker, 1)
    with publishing(worker, writer, from_json(registry, STRING, {"data": "x"})):

        def measured() -> Any:
            """Return the figures if the rate is plausible: messages that a busy process receives late are a burst."""
            figures = midspan("topic", "hz", "/chatter", "--count", "20", "--json").lines()[-1]
            return 0 < figures["rate"] < 60 and figures

        line = until(measured, "the rate is that of the publisher")
        output = midspan("topic", "hz", "/chatter", "--count", "5").out
    assert line["messages"] == line["window"] == 20
    assert line["least"] <= line["most"]
    assert "msg/s" in output
    silent = midspan("topic", "hz", "/chatter", "--duration", "0.2")
    assert (silent.code, "no message of /chatter arrived" in silent.err) == (1, True), silent


def test_pub_reaches_the_side(
    midspan: Midspan, worker: EngineWorker, registry: Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bridge.client.publishing.MATCH_SECONDS", 40.0)
    received: list[bytes] = []
    worker.side.read_from(
        "/cmd", STRING, Qos(), MadeBy.NATIVE, "/robot", lambda cdr, _source, _time: received.append(cdr)
    )
    done = midspan("topic", "pub", "/cmd", "std_msgs/String", "{data: go}", "--once", "--settle", "0.5")
    assert done.code == 0, done
    until(lambda: received, "the message arrives")
    assert [to_json(registry, STRING, cdr) for cdr in received] == [{"data": "go"}]


def test_pub_counts_and_latches(
    midspan: Midspan, network: HubNetwork, closing: list[Any], registry: Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bridge.client.publishing.MATCH_SECONDS", 40.0)
    listener = FakeWorker(network, "native")
    closing.append(listener)
    received = listener.subscribe("/count", STRING, Qos())
    args = ("--rate", "100", "--count", "3", "--settle", "0")
    assert midspan("topic", "pub", "/count", "std_msgs/msg/String", '{"data": "x"}', *args).code == 0
    until(lambda: len(received) >= 3, "the messages arrive")
    assert [to_json(registry, STRING, sample.data())["data"] for sample in received] == ["x"] * 3

    latched = listener.subscribe("/latched", STRING, LATCHED)
    midspan("topic", "pub", "/latched", STRING, "--latch", "--count", "1", "--settle", "0")
    until(lambda: len(latched) == 1, "the latched message arrives")
    until(lambda: not listener.hub.graph.publishers("/latched"), "the latched topic's publisher is gone")


@pytest.mark.parametrize(
    ("type_name", "message", "words"),
    [
        ("geometry_msgs/Twist", "{linaer: {x: 1}}", "linear"),
        ("geometry_msgs/Twist", "{linear: {x: fast}}", "linear"),
        ("geometry_msgs/Twist", "[1, 2]", "map of fields"),
        ("geometry_msgs/Twist", "{linear: ", "neither YAML nor JSON"),
        ("geometry_msgs/Twits", "{}", "geometry_msgs/msg/Twist"),
        ("Twist", "{}", "std_msgs/String"),
        ("no_such_msgs/Thing", "{}", "no_such_msgs"),
    ],
)
def test_pub_reports_errors(midspan: Midspan, type_name: str, message: str, words: str) -> None:
    done = midspan("topic", "pub", "/cmd_vel", type_name, message, "--once")
    assert (done.code, words in done.err) == (1, True), done


def test_pub_warns_of_sides_that_it_does_not_reach(midspan: Midspan, worker: EngineWorker, network: HubNetwork) -> None:
    del worker
    with Hub.open(network.settings("native")) as hub:
        other = hub.publisher("/secret", "std_msgs/msg/Bool", "RIHS01_" + "1" * 64, Qos())
        done = midspan("topic", "pub", "/secret", STRING, "--once", "--settle", "0.5")
        other.close()
    assert "the messages do not reach ROS 1: denied: rule 1 denies it" in done.err
    assert "/secret is std_msgs/msg/Bool elsewhere" in done.err


def test_pub_does_not_warn_of_a_type_that_the_topic_has_among_others(midspan: Midspan, network: HubNetwork) -> None:
    """For example, BaseControl subscribes to /cmd_vel with and without a stamp."""
    with Hub.open(network.settings("native")) as hub:
        ends = [
            hub.subscription("/both", type_name, "RIHS01_" + digit * 64, Qos(), lambda _: None)
            for type_name, digit in ((STRING, "1"), ("std_msgs/msg/Bool", "2"))
        ]
        done = midspan("topic", "pub", "/both", STRING, "--once", "--settle", "0.5")
        for end in ends:
            end.close()
    assert (done.code, "elsewhere" in done.err) == (0, False), done
