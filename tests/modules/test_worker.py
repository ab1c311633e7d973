"""The worker that hosts modules: start, live reload, failures, counters, YARP ports, and a worker for one module."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.modules.worker import ModulesWorker
from tests.peers.hub.modules import STRING, Place
from tests.support.wait import until
from yarp_compat.naming import connections
from yarp_compat.naming.server import NameServer
from yarp_compat.pythonic import Client, Reader, Writer
from yarp_compat.wire.generation import Generation

ECHO = "tests.peers.hub.echo:Echo"


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    with Place(tmp_path) as place:
        yield place


def echo(name: str = "echo", **options: Any) -> dict[str, Any]:
    return {"name": name, "factory": ECHO, "options": options}


def test_a_module_subscribes_publishes_and_counts_messages(place: Place) -> None:
    subscription = place.far.subscribe("/said", STRING)
    place.worker.start(place.config(echo(prefix="again ")))
    place.until_replied("hello", subscription, "again hello")

    def counted() -> dict[str, Any] | None:
        """Return the status once it counts messages on all topics; messages are counted after their delivery."""
        status = place.status("echo")
        return status if status and all(end["messages"] for end in status["topics"]) else None

    status = until(counted, "the module counts received and published messages")
    assert status is not None
    assert status["state"] == "running"
    assert status["heard"] >= 1
    assert {(end["topic"], end["end"]) for end in status["topics"]} == {
        ("/heard", "subscription"),
        ("/said", "publisher"),
    }
    assert {port["port"]: port["state"] for port in status["ports"]} == dict.fromkeys(
        ("/echo/said:o", "/echo/rpc", "/echo/heard:i"), "waiting"
    )
    assert "heard" in place.worker.health().text


def test_a_module_continues_after_a_failed_callback(place: Place, caplog: pytest.LogCaptureFixture) -> None:
    subscription = place.far.subscribe("/said", STRING)
    place.worker.start(place.config(echo()))
    place.until_replied("one", subscription, "one")
    out = place.far.advertise("/heard", STRING)
    until(lambda: (place.far.publish(out, {"data": "break"}), "one step failed" in caplog.text)[1], "a callback fails")
    place.until_replied("two", subscription, "two")


def test_ports_open_when_a_name_server_starts(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bridge.modules.ports._ASK_SECONDS", 40.0)  # the name server may stand still
    place.worker.start(place.config(echo()))
    until(lambda: "waiting" in str(place.status("echo")), "the status reports waiting ports")
    with NameServer(port=place.port, gc_seconds=0):
        until(lambda: connections.exists(place.names, "/echo/said:o"), "the port is registered")
        until(lambda: "waiting" not in str(place.answer("echo")["ports"]), "all ports are open")
        with Client("/echo/rpc", naming=place.names) as client:
            assert client.ask(["hello", 4], timeout=40) == ["said", "hello", 4]
        with (
            Reader("/test/heard:i", naming=place.names, strict=True) as reader,
            Writer("/test/said:o", naming=place.names) as writer,
        ):
            connections.connect(place.names, "/echo/said:o", "/test/heard:i")
            writer.connect("/echo/heard:i")
            writer.write(["ahoy"])
            received = reader.read()
            assert received is not None
            assert received.values == ["ahoy"]
        place.worker.stop()
        assert place.names.query("/echo/rpc") is None


def test_a_stopped_module_runs_no_more_callbacks(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    place.worker.start(place.config(echo()))
    running = place.worker.running("echo")
    host, module = running.host, running.module
    executed: list[str] = []
    close = host.yarp.close
    monkeypatch.setattr("bridge.modules.worker.STOP_SECONDS", 60.0)

    def post_and_close() -> None:
        host.loop.post(lambda: executed.append("posted"))
        with pytest.raises(TimeoutError, match="has ended"):
            host.loop.call(lambda: executed.append("called"))
        close()

    def stop() -> None:
        host.loop.after(0.0, lambda: executed.append("timer"))
        host.loop.post(lambda: executed.append("posted before"))
        executed.append("stopped")

    monkeypatch.setattr(host.yarp, "close", post_and_close)
    monkeypatch.setattr(module, "stop", stop)
    running.stop()
    assert executed == ["stopped"]


def test_a_failing_health_check_does_not_affect_other_modules(
    place: Place, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    place.worker.start(place.config(echo(), echo("other")))
    module = place.worker.running("echo").module
    assert module is not None
    monkeypatch.setattr(module, "health", lambda: [][0])
    for _ in range(2):
        health = place.worker.health()
    assert health.state == "running"
    assert "echo waiting: health check failed: IndexError" in health.text
    assert "other: heard 0" in health.text
    assert "IndexError" in place.answer("echo")["text"]
    assert caplog.text.count("echo: health check failed") == 1


def test_a_reload_affects_only_changed_modules(place: Place) -> None:
    """All modules share a session; opening and closing one module's endpoints leaves the other modules' open."""
    graph = place.far.hub.graph

    def ends(node: str) -> dict[str, bytes]:
        return {end.topic: end.gid for end in graph.endpoints() if end.node == node}

    subscription = place.far.subscribe("/said", STRING)
    place.worker.start(place.config(echo(), echo("other")))
    place.until_replied("a", subscription, "a")
    until(lambda: ends("echo").keys() == ends("other").keys() == {"/heard", "/said"}, "the graph names both modules")
    original, zid = ends("echo"), place.answer("echo")["zid"]
    snapshots: list[dict[str, bytes]] = []
    unwatch = graph.watch(lambda: snapshots.append(ends("echo")))
    assert place.worker.reload(place.config(echo(prefix="new "), echo("third")))
    place.until_replied("b", subscription, "new b")
    until(
        lambda: place.status("third") and ends("third") and not ends("other"), "the third module replaces the other one"
    )
    assert place.status("other") is None
    unwatch()
    assert snapshots, "the graph has changed"
    assert all(snapshot == original for snapshot in snapshots), "the module reloads without a restart"
    assert {node.zid for node in graph.nodes() if node.node in {"echo", "third"}} == {zid}, (
        "both modules have the same session"
    )
    assert place.worker.reload(place.config(echo(restart=True), echo("third")))
    until(lambda: ends("echo").keys() == original.keys() and ends("echo") != original, "the module has restarted")
    place.until_replied("c", subscription, "c")
    assert not place.worker.reload(place.config(echo(), name="elsewhere")), "the worker needs a restart"


def test_a_blocked_module_does_not_delay_others(place: Place) -> None:
    subscription = place.far.subscribe("/said", STRING)
    place.worker.start(place.config(echo(), echo("other", prefix="other ")))
    place.until_replied("a", subscription, "other a")
    blocked, release = place.worker.running("echo").host.loop, threading.Event()
    blocked.post(release.wait)
    try:
        place.until_replied("b", subscription, "other b")
        assert "b" not in {message["data"] for message in place.far.wait(subscription, 0)}
        assert place.answer("other")["state"] == "running"
    finally:
        release.set()
    place.until_replied("c", subscription, "c")


def test_a_changed_yarp_release_applies_without_a_restart(place: Place) -> None:
    """Connections stay open; the next call is answered in the new release's format."""
    place.worker.start(place.config(echo(), yarp=place.yarp_section()))
    original = place.answer("echo")
    host = place.worker.running("echo").host
    assert host is not None
    assert not host.yarp.generations.of("/nav").sure
    topics = [{"topic": "/scan", "as": "natural"}]  # this setting concerns only the ports of other workers
    for changed in ({"release": "3.9"}, {"peers": [{"port": "/nav", "release": "3.9"}], "topics": topics}):
        assert place.worker.reload(place.config(echo(), yarp=place.yarp_section(**changed)))
        assert host.yarp.generations.of("/nav").generation is Generation.YARP_3_6
    assert not host.yarp.generations.of("/other").sure
    assert place.answer("echo")["zid"] == original["zid"], "the module keeps running"
    another_network = place.yarp_section(namespace="/other")
    assert not place.worker.reload(place.config(echo(), yarp=another_network)), "the ports need a restart"


def test_a_module_that_cannot_start_does_not_affect_others_and_is_restarted(place: Place) -> None:
    subscription = place.far.subscribe("/said", STRING)
    bad = [
        {"name": "nowhere", "factory": "tests.modules.nowhere:Module"},
        {"name": "nothing", "factory": "tests.peers.hub.echo:NoModule"},
        echo("refuses", refuse=True),
    ]
    place.worker.start(place.config(*bad, echo()))
    place.until_replied("a", subscription, "a")
    health = place.worker.health()
    assert health.state == "running"
    assert "refuses waiting: start refused by its options" in health.text
    statuses = {
        name: until(lambda name=name: place.status(name), "the failure is reported") for name in ("nowhere", "refuses")
    }
    assert {status["state"] for status in statuses.values()} == {"waiting"}
    assert statuses["refuses"]["text"] == "start refused by its options"
    assert "tests.modules.nowhere" in statuses["nowhere"]["text"]
    assert place.worker.reload(place.config(*bad[:2], echo("refuses"), echo()))
    until(lambda: "start refused" not in place.worker.health().text, "the module has started")
    assert place.answer("refuses")["state"] == "running"


def test_a_worker_for_one_module_runs_no_other(place: Place) -> None:
    place.worker = place.keep(ModulesWorker("other"))
    place.worker.start(place.config(echo(), echo("other")))
    until(lambda: place.status("other"), "the module runs")
    assert place.status("echo") is None
