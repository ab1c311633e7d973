"""The worker that hosts modules: start, live reload, failure, counters, YARP ports, one module alone."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.modules.worker import ModulesWorker
from tests.modules.place import STRING, Place
from tests.support.wait import until
from yarp_compat.naming import connections
from yarp_compat.naming.server import NameServer
from yarp_compat.pythonic import Client, Reader, Writer
from yarp_compat.wire.generation import Generation

ECHO = "tests.modules.echo:Echo"


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    with Place(tmp_path) as made:
        yield made


def echo(name: str = "echo", **options: Any) -> dict[str, Any]:
    return {"name": name, "factory": ECHO, "options": options}


def test_a_module_hears_and_says_on_the_hub_and_counts(place: Place) -> None:
    heard = place.far.subscribe("/said", STRING)
    place.worker.start(place.config(echo(prefix="again ")))
    place.hears("hello", heard, "again hello")

    def counted() -> dict[str, Any] | None:
        """Its status, once what it said is counted: that comes after it was heard."""
        status = place.status("echo")
        return status if status and all(end["messages"] for end in status["topics"]) else None

    status = until(counted, "the module counts what came and went")
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


def test_a_step_that_fails_stops_nothing(place: Place, caplog: pytest.LogCaptureFixture) -> None:
    heard = place.far.subscribe("/said", STRING)
    place.worker.start(place.config(echo()))
    place.hears("one", heard, "one")
    out = place.far.advertise("/heard", STRING)
    until(lambda: (place.far.publish(out, {"data": "break"}), "one step failed" in caplog.text)[1], "it broke")
    place.hears("two", heard, "two")


def test_its_ports_open_when_a_name_server_comes(place: Place) -> None:
    place.worker.start(place.config(echo()))
    until(lambda: "waiting" in str(place.status("echo")), "it tells that its ports wait")
    with NameServer(port=place.port, gc_seconds=0):
        until(lambda: connections.exists(place.names, "/echo/said:o"), "the port is registered")
        until(lambda: "waiting" not in str(place.answer("echo")["ports"]), "all are open")
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


def test_what_comes_to_a_module_that_has_stopped_is_left_undone(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    place.worker.start(place.config(echo()))
    running = place.worker.running("echo")
    host, module = running.host, running.module
    done: list[str] = []
    close = host.yarp.close

    def slowly() -> None:
        host.loop.post(lambda: done.append("posted"))
        with pytest.raises(TimeoutError, match="has ended"):
            host.loop.call(lambda: done.append("called"))
        close()

    def stop() -> None:
        host.loop.after(0.0, lambda: done.append("timer"))
        host.loop.post(lambda: done.append("posted before"))
        done.append("stopped")

    monkeypatch.setattr(host.yarp, "close", slowly)
    monkeypatch.setattr(module, "stop", stop)
    running.stop()
    assert done == ["stopped"]


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
    assert "echo: waiting health check failed: IndexError" in health.text
    assert "other: heard 0" in health.text
    assert "IndexError" in place.answer("echo")["text"]
    assert caplog.text.count("echo: health check failed") == 1


def test_reload_touches_what_changed_alone(place: Place) -> None:
    """All modules share a session: what one has there comes and goes without the others'."""
    graph = place.far.hub.graph

    def ends(node: str) -> dict[str, bytes]:
        return {end.topic: end.gid for end in graph.endpoints() if end.node == node}

    heard = place.far.subscribe("/said", STRING)
    place.worker.start(place.config(echo(), echo("other")))
    place.hears("a", heard, "a")
    until(lambda: ends("echo").keys() == ends("other").keys() == {"/heard", "/said"}, "both are on the hub by name")
    before, zid = ends("echo"), place.answer("echo")["zid"]
    looks: list[dict[str, bytes]] = []
    unwatch = graph.watch(lambda: looks.append(ends("echo")))
    assert place.worker.reload(place.config(echo(prefix="new "), echo("third")))
    place.hears("b", heard, "new b")
    until(lambda: place.status("third") and ends("third") and not ends("other"), "the one has come, the other gone")
    assert place.status("other") is None
    unwatch()
    assert looks, "that was seen"
    assert all(look == before for look in looks), "it took up its section while it ran"
    assert {node.zid for node in graph.nodes() if node.node in {"echo", "third"}} == {zid}, "on one session"
    assert place.worker.reload(place.config(echo(restart=True), echo("third")))
    until(lambda: ends("echo").keys() == before.keys() and ends("echo") != before, "it runs again")
    place.hears("c", heard, "c")
    assert not place.worker.reload(place.config(echo(), name="elsewhere")), "the worker is to be started again"


def test_one_that_stands_still_delays_no_other(place: Place) -> None:
    heard = place.far.subscribe("/said", STRING)
    place.worker.start(place.config(echo(), echo("other", prefix="other ")))
    place.hears("a", heard, "other a")
    still, goes_on = place.worker.running("echo").host.loop, threading.Event()
    still.post(goes_on.wait)
    try:
        place.hears("b", heard, "other b")
        assert "b" not in {message["data"] for message in place.far.wait(heard, 0)}
        assert place.status("other") is not None
    finally:
        goes_on.set()
    place.hears("c", heard, "c")


def test_a_release_of_yarp_is_taken_up_while_all_runs(place: Place) -> None:
    """Nothing restarts, and who is connected stays so: the next call is answered otherwise."""
    place.worker.start(place.config(echo(), yarp=place.yarp_section()))
    before = place.answer("echo")
    host = place.worker.running("echo").host
    assert host is not None
    assert not host.yarp.generations.of("/nav").sure
    topics = [{"topic": "/scan", "as": "natural"}]  # what other workers' ports carry
    for changed in ({"release": "3.9"}, {"peers": [{"port": "/nav", "release": "3.9"}], "topics": topics}):
        assert place.worker.reload(place.config(echo(), yarp=place.yarp_section(**changed)))
        assert host.yarp.generations.of("/nav").generation is Generation.YARP_3_6
    assert not host.yarp.generations.of("/other").sure
    assert place.answer("echo")["zid"] == before["zid"], "it goes on"
    assert not place.worker.reload(place.config(echo(), yarp=place.yarp_section(namespace="/other"))), (
        "its ports are others"
    )


def test_one_that_cannot_start_keeps_no_other_from_it_and_is_tried_again(place: Place) -> None:
    heard = place.far.subscribe("/said", STRING)
    bad = [
        {"name": "nowhere", "factory": "tests.modules.nowhere:Module"},
        {"name": "nothing", "factory": "tests.modules.echo:NoModule"},
        echo("refuses", refuse=True),
    ]
    place.worker.start(place.config(*bad, echo()))
    place.hears("a", heard, "a")
    health = place.worker.health()
    assert health.state == "running"
    assert "refuses: waiting it was told to refuse" in health.text
    assert place.worker.reload(place.config(*bad[:2], echo("refuses"), echo()))
    until(lambda: "told to refuse" not in place.worker.health().text, "it was started again")


def test_one_module_alone(place: Place) -> None:
    place.worker = ModulesWorker("other")
    place.worker.start(place.config(echo(), echo("other")))
    until(lambda: place.status("other"), "the one runs")
    assert place.status("echo") is None
