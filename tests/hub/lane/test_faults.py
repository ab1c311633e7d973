"""Sessions that stop, die or cannot have a lane do not block others, and zenoh carries their messages."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import threading
from pathlib import Path
from typing import Any

import pytest

from bridge.hub.endpoints import lane_subscription
from bridge.hub.lane import folder
from bridge.hub.lane.blocks import Blocks
from bridge.hub.lane.queues import MAX_LOANS
from bridge.hub.lane.wire import DATA, HEAD, MARK, PART, PIECE, SAMPLE, VERSION
from bridge.hub.node import Hub
from bridge.hub.wire.keys import pack_attachment
from tests.peers.hub.endpoints import STREAM, Subscriber, advertise, matched
from tests.peers.hub.lane import goes_by, subscription, whole
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until

PATIENT = {"transport": {"link": {"tx": {"lease": 100_000}}}}
"""With the default of 3 s, a reader that is stopped for longer, because the test is slow, leaves the hub."""


def test_stalled_reader_does_not_block_others(network: HubNetwork, tmp_path: Path) -> None:
    lane, count = str(tmp_path), 6000
    with (
        Hub.open(network.settings("writer", lane=lane)) as writer,
        network.hub_peer("reader", lane=lane, zenoh=PATIENT) as reader,
    ):
        publisher = advertise(writer, "/t")
        number = reader.ask("subscription", topic="/t")["id"]
        until(lambda: reader.ask("way", id=number)["way"] == "lane", "the subscription uses the lane")
        os.kill(reader.pid, signal.SIGSTOP)

        def publish_all() -> None:
            for number in range(count):
                publisher.put(str(number).encode().ljust(2000))

        publishing = threading.Thread(target=publish_all, daemon=True)
        publishing.start()
        publishing.join(30.0)
        os.kill(reader.pid, signal.SIGCONT)
        assert not publishing.is_alive(), "no put waits for the reader"

        def newest() -> bool:
            return str(count - 1) in reader.ask("wait", id=number, count=0, seconds=0.0)["texts"][-1:][0].strip()

        until(
            lambda: reader.ask("wait", id=number, count=1, seconds=9.0)["texts"] and newest(),
            "the last message has arrived",
        )
        numbers = [int(text) for text in reader.ask("wait", id=number, count=0, seconds=0.0)["texts"]]
        assert numbers == sorted(set(numbers))
        dropped = writer.lane().dropped
        assert dropped == count - len(numbers) > 0
        assert reader.ask("way", id=number)["lost"] == dropped


def test_stopped_reader_has_only_a_few_large_messages(network: HubNetwork, tmp_path: Path) -> None:
    lane, count, size = str(tmp_path), 50, 1_000_000
    with (
        Hub.open(network.settings("writer", lane=lane)) as writer,
        network.hub_peer("reader", lane=lane, zenoh=PATIENT) as reader,
    ):
        publisher = advertise(writer, "/t")
        number = reader.ask("subscription", topic="/t")["id"]
        until(lambda: reader.ask("way", id=number)["way"] == "lane", "the subscription uses the lane")

        def only_on_the_lane() -> Blocks | None:
            publisher.put(b"early".ljust(size))  # a message is sent over zenoh, too, until zenoh has no subscriber
            return publisher.blocks()

        blocks = until(only_on_the_lane, "no message uses zenoh")
        os.kill(reader.pid, signal.SIGSTOP)
        for each in range(count):
            publisher.put(str(each).encode().ljust(size))
        assert blocks.size <= (MAX_LOANS + 1) * size
        os.kill(reader.pid, signal.SIGCONT)

        def texts() -> list[str]:
            return list(reader.ask("wait", id=number, count=1, seconds=9.0)["texts"])

        until(lambda: [text.strip() for text in texts()][-1:] == [str(count - 1)], "the last message has arrived")
        assert {len(text) for text in texts()} == {size}


@pytest.mark.parametrize("size", [1, 300_000])
def test_killed_reader_is_removed_and_the_next_reader_is_served(network: HubNetwork, tmp_path: Path, size: int) -> None:
    lane = str(tmp_path)
    with Hub.open(network.settings("writer", lane=lane)) as writer:
        publisher = advertise(writer, "/t")
        for _ in range(2):
            with network.hub_peer("reader", lane=lane) as reader:
                number = reader.ask("subscription", topic="/t")["id"]
                until(lambda n=number, r=reader: r.ask("way", id=n)["way"] == "lane", "the subscription uses the lane")
                publisher.put(b"x" * size)
                assert reader.ask("wait", id=number, count=1, seconds=40.0)["texts"] == ["x" * size]
                os.kill(reader.pid, signal.SIGKILL)
            until(lambda: publisher.way()[0] != "lane", "the reader's lane is gone")


@pytest.mark.parametrize(("size", "count"), [(60_000, 100), (1_000_000, 20)])
def test_killed_writer_leaves_only_whole_messages(network: HubNetwork, tmp_path: Path, size: int, count: int) -> None:
    lane = str(tmp_path)
    with Hub.open(network.settings("reader", lane=lane)) as reader:
        subscriber = Subscriber(reader, "/t")
        for _ in range(2):
            with network.hub_peer("writer", lane=lane) as writer:
                number = writer.ask("publisher", topic="/t")["id"]
                writer.ask("drum", id=number, rate=3e8 / size, size=size)
                goes_by(subscriber, "lane")
                until(lambda: len(subscriber.texts()) > count, "the writer publishes")
                os.kill(writer.pid, signal.SIGKILL)
            goes_by(subscriber, "zenoh", "no other worker publishes it")
            texts = subscriber.texts()
            assert {len(text) for text in texts} == {size}
            numbers = [int(text) for text in texts]  # at 300 MB/s some messages are dropped, which is correct
            assert numbers == sorted(set(numbers))
            subscriber.samples.clear()


def accepted(listener: socket.socket) -> socket.socket | None:
    try:
        return listener.accept()[0]
    except TimeoutError:
        return None


def test_partial_message_is_not_delivered(network: HubNetwork, tmp_path: Path) -> None:
    """The other end is a bare socket that stands in for a worker that dies in the middle of a message."""
    with Hub.open(network.settings("reader", lane=str(tmp_path))) as reader:
        subscriber = Subscriber(reader, "/t")
        with Hub.open(network.settings("writer")) as writer:  # only for its token on the graph
            publisher = advertise(writer, "/t")
            listener = folder.listen(tmp_path, writer.zid)
            listener.settimeout(0.5)
            sock = until(lambda: accepted(listener) or advertise(writer, "/another").close(), "the reader connects")
            sock.settimeout(20.0)
            record = sock.recv(1000)
            _, key = HEAD.unpack_from(record)
            gid = publisher.gid
            sock.send(HEAD.pack(MARK, key) + pack_attachment(0, 0, gid))
            goes_by(subscriber, "lane")
            sock.send(SAMPLE.pack(DATA, key, 5, 1, 1, gid) + b"whole")
            sock.send(HEAD.pack(PART, key) + pack_attachment(2, 2, gid) + PIECE.pack(100_000, 0) + bytes(50_000))
            sock.shutdown(socket.SHUT_RDWR)
            sock.close()
            listener.close()
            goes_by(subscriber, "zenoh")
            matched(publisher)
            publisher.sender.sequence = 1
            publisher.put(b"by zenoh")
            subscriber.expect("whole", "by zenoh")


@pytest.mark.parametrize("end", ["reader", "writer"])
def test_without_descriptors_all_messages_use_zenoh(network: HubNetwork, tmp_path: Path, end: str) -> None:
    lane = str(tmp_path)
    with network.hub_peer("reader", lane=lane) as reader, network.hub_peer("writer", lane=lane) as writer:
        peers = {"reader": reader, "writer": writer}
        warm = reader.ask("subscription", topic="/kept", latched=True)["id"]
        writer.ask("put", id=writer.ask("publisher", topic="/kept", latched=True)["id"], text="x")
        assert reader.ask("wait", id=warm, count=1, seconds=40.0)["texts"], "the workers are linked"
        subscription_id = reader.ask("subscription", topic="/t")["id"]
        peers[end].ask("exhaust", on=True)
        says = writer.ask("publisher", topic="/t")["id"]
        writer.ask("drum", id=says, rate=100.0)
        texts = reader.ask("wait", id=subscription_id, count=150, seconds=40.0)["texts"]
        whole(texts)
        assert reader.ask("way", id=subscription_id)["way"] == "zenoh"
        peers[end].ask("exhaust", on=False)
        until(lambda: reader.ask("way", id=subscription_id)["way"] == "lane", "with descriptors, the lane is used")
        whole(reader.ask("wait", id=subscription_id, count=len(texts) + 200, seconds=40.0)["texts"])


def test_large_messages_are_sent_if_the_system_is_out_of_threads(
    network: HubNetwork, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    lane = str(tmp_path)
    with Hub.open(network.settings("writer", lane=lane)) as writer, network.hub_peer("reader", lane=lane) as reader:
        publisher = advertise(writer, "/t")
        number = reader.ask("subscription", topic="/t")["id"]
        until(lambda: reader.ask("way", id=number)["way"] == "lane", "the subscription uses the lane")

        def refuse(_: object) -> None:
            raise RuntimeError("can't start new thread")

        monkeypatch.setattr(threading.Thread, "start", refuse)
        for count in (1, 2):
            publisher.put(b"x" * 100_000)
            assert reader.ask("wait", id=number, count=count, seconds=40.0)["texts"] == count * ["x" * 100_000]
        monkeypatch.undo()
        assert "a reader of the lane is disconnected" not in caplog.text
        assert reader.ask("way", id=number)["way"] == "lane"


def test_large_messages_use_zenoh_once_the_reader_has_no_descriptors(network: HubNetwork, tmp_path: Path) -> None:
    # zenoh's own shared memory needs a descriptor, too: large messages arrive only until the writer's pool exists
    settings: dict[str, Any] = {"lane": str(tmp_path), "shared_memory": False}
    size = 100_000
    with Hub.open(network.settings("writer", **settings)) as writer, network.hub_peer("reader", **settings) as reader:
        publisher = advertise(writer, "/t")
        number = reader.ask("subscription", topic="/t")["id"]
        until(lambda: reader.ask("way", id=number)["way"] == "lane", "the subscription uses the lane")
        publisher.put(b"small")
        assert reader.ask("wait", id=number, count=1, seconds=40.0)["texts"] == ["small"]
        reader.ask("exhaust", on=True)

        def arrived() -> list[str]:
            publisher.put(b"x" * size)
            return list(reader.ask("wait", id=number, count=2, seconds=0.1)["texts"])

        until(lambda: arrived()[1:], "a large message arrives")
        assert {len(text) for text in arrived()[1:]} == {size}
        assert "lane" not in reader.ask("way", id=number)["way"]
        reader.ask("exhaust", on=False)
        until(lambda: arrived() and reader.ask("way", id=number)["way"] == "lane", "with descriptors, the lane is used")
        count = len(arrived())
        until(lambda: len(arrived()) >= count + 2, "large messages arrive on the lane")


def test_messages_use_zenoh_if_the_folder_cannot_be_written_to(network: HubNetwork, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    lane = str(tmp_path / "file" / "lane")
    with Hub.open(network.settings("a", lane=lane)) as a, Hub.open(network.settings("b", lane=lane)) as b:
        subscriber, publisher = Subscriber(b, "/t"), advertise(a, "/t")
        matched(publisher)
        publisher.put(b"x")
        subscriber.expect("x")
        goes_by(subscriber, "zenoh", "a: Not a directory")
        assert publisher.way()[1].endswith("Not a directory")


def test_other_users_are_refused(network: HubNetwork, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lane = str(tmp_path)
    with Hub.open(network.settings("a", lane=lane)) as a, Hub.open(network.settings("b", lane=lane)) as b:
        assert all(path.stat().st_mode & 0o777 == 0o600 for path in tmp_path.iterdir())
        user = os.geteuid() + 1
        monkeypatch.setattr(os, "geteuid", lambda: user)
        subscriber, publisher = Subscriber(b, "/t"), advertise(a, "/t")
        matched(publisher)
        publisher.put(b"x")
        subscriber.expect("x")
        goes_by(subscriber, "zenoh", "the other end of the lane belongs to user")


def test_sockets_of_dead_processes_are_removed(network: HubNetwork, tmp_path: Path) -> None:
    lane = str(tmp_path)
    with network.hub_peer("dies", lane=lane) as peer:
        peer.ask("publisher", topic="/t")
        os.kill(peer.pid, signal.SIGKILL)
        peer.popen.wait()
    assert len(list(tmp_path.iterdir())) == 1
    with Hub.open(network.settings("next", lane=lane)) as hub:
        assert [path.name for path in tmp_path.iterdir()] == [f"{hub.zid}.{VERSION}"]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("writers", "readers"), [(VERSION - 1, VERSION), (VERSION, VERSION - 1)])
def test_workers_whose_lanes_have_other_versions_use_zenoh(
    network: HubNetwork, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writers: int, readers: int
) -> None:
    """During an upgrade, a worker of the new release may start while a worker of the old release still runs."""
    lane = str(tmp_path)
    monkeypatch.setattr(folder, "VERSION", writers)
    with Hub.open(network.settings("writer", lane=lane)) as writer:
        monkeypatch.setattr(folder, "VERSION", readers)
        with Hub.open(network.settings("reader", lane=lane)) as reader:
            subscriber, publisher = Subscriber(reader, "/t"), advertise(writer, "/t")
            matched(publisher)
            publisher.put(b"x")
            subscriber.expect("x")
            why = f"its lane has version {writers}, ours {readers}; zenoh is used instead"
            goes_by(subscriber, "zenoh", f"writer: {why}")
        monkeypatch.setattr(folder, "VERSION", writers)


def test_sockets_of_other_versions_are_removed_once_dead(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(folder, "VERSION", VERSION - 1)
    folder.listen(tmp_path, "dead").close()
    with contextlib.closing(folder.listen(tmp_path, "alive")):
        monkeypatch.setattr(folder, "VERSION", VERSION)
        folder.clean(tmp_path)
        assert [path.name for path in tmp_path.iterdir()] == [f"alive.{VERSION - 1}"]


def test_early_messages_arrive_once(network: HubNetwork, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lane = str(tmp_path)
    monkeypatch.setattr(lane_subscription, "EARLY_SECONDS", 40.0)  # on a busy machine, zenoh's messages may be late
    with Hub.open(network.settings("writer", lane=lane)) as writer, Hub.open(network.settings("b", lane=lane)) as b:
        publisher = advertise(writer, "/t", STREAM, "before")  # zenoh may hold the message until there is a subscriber
        subscriber = Subscriber(b, "/t")
        matched(publisher)
        for number in range(500):
            publisher.put(str(number).encode())
        until(lambda: subscriber.texts()[-1:] == ["499"], "all messages arrive")
        assert [text for text in subscriber.texts() if text != "before"] == [str(number) for number in range(500)]
        goes_by(subscriber, "lane")
        assert not subscription(subscriber).lost
