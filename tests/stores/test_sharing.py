"""Replicas of several daemons on one hub: convergence, also after separation, and plain zenoh programs."""

from __future__ import annotations

import contextlib
import json
import logging
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import zenoh

from bridge.client.store import StoreClient
from bridge.hub.endpoints.keyspace import KeySpace
from bridge.hub.node import Hub
from bridge.hub.wire.version import WIRE
from bridge.stores.entry import StoreError
from bridge.stores.kinds import AREA, BEHAVIOR, LOCATION, MAP, PATH
from bridge.stores.replica import StoreLimits
from bridge.stores.store import Write
from bridge.stores.wire import prefix
from tests.peers.hub.quick import QuickHub
from tests.stores.parts import Shared
from tests.stores.test_store import KITCHEN, grid
from tests.support.wait import until
from yarp_compat.dev.extras import AreaBehavior
from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DPath
from yarp_compat.sig.vec2d import Vec2D

SECONDS = 30.0


@pytest.fixture
def hub() -> Iterator[QuickHub]:
    with QuickHub() as network:
        yield network


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let clients wait for a store on a busy machine."""
    monkeypatch.setattr("bridge.client.store._FIND_SECONDS", 40.0)


def names(shared: Shared) -> list[str]:
    return shared.store.names(LOCATION)


def same(*stores: Shared) -> bool:
    return all(store.replica.versions() == stores[0].replica.versions() for store in stores)


def all_joined(*stores: Shared) -> None:
    for store in stores:
        until(lambda store=store: len(store.others()) == len(stores) - 1, "all replicas reach each other", SECONDS)


def test_a_write_reaches_all_replicas(hub: QuickHub, tmp_path: Path) -> None:
    with Shared(tmp_path, "one", hub.endpoint) as first_store, Shared(tmp_path, "two", hub.endpoint) as second_store:
        all_joined(first_store, second_store)
        changes: list[tuple[str, str, bool, str, bool]] = []
        second_store.store.watch(lambda c: changes.append((c.kind, c.name, c.deleted, c.origin, c.here)))
        first_store.store.put(MAP, "m1", grid())
        first_store.store.put(LOCATION, "the kitchen", KITCHEN)
        until(lambda: names(second_store) and second_store.store.names(MAP), "both values have arrived", SECONDS)
        assert second_store.store.get(MAP, "m1") == grid()
        assert second_store.store.get(LOCATION, "the kitchen") == KITCHEN
        second_store.store.delete(LOCATION, "the kitchen")
        until(lambda: not names(first_store), "the deletion has arrived", SECONDS)
        until(lambda: len(changes) == 3, "all changes are received", SECONDS)
        assert sorted(changes[:2]) == [  # in any order, as the stores may still compare their contents
            ("location", "the kitchen", False, "one", False),
            ("map", "m1", False, "one", False),
        ]
        assert changes[2] == ("location", "the kitchen", True, "two", True)
        assert first_store.replica.status().conflicts == second_store.replica.status().conflicts == 0


def test_three_separated_replicas_converge_after_joining_again(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with contextlib.ExitStack() as stack:
        first, second = (stack.enter_context(QuickHub()) for _ in range(2))
        first_store = stack.enter_context(Shared(tmp_path, "one", first.endpoint))
        second_store = stack.enter_context(Shared(tmp_path, "two", first.endpoint))
        third_store = stack.enter_context(Shared(tmp_path, "three", first.endpoint))
        all_joined(first_store, second_store, third_store)
        for number in range(20):
            first_store.store.put(LOCATION, f"common{number}", KITCHEN)
        until(
            lambda: same(first_store, second_store, third_store) and len(names(third_store)) == 20,
            "all start with the same content",
            SECONDS,
        )
        for store in (second_store, third_store):  # the second is then on its own, the third joins another router
            store.disconnect()
        third_store.join(second.endpoint)
        first_store.store.put(LOCATION, "of one", KITCHEN)
        first_store.store.delete(LOCATION, "common1")
        first_store.store.put(LOCATION, "both", Map2DLocation("m1", 1.0))
        first_store.store.put(LOCATION, "common3", Map2DLocation("m1", 31.0))
        first_store.store.put(MAP, "m1", grid())
        second_store.store.put(LOCATION, "of two", KITCHEN)
        second_store.store.delete(LOCATION, "common2")
        second_store.store.put(LOCATION, "both", Map2DLocation("m1", 2.0))
        second_store.store.delete(LOCATION, "common3")
        third_store.store.put(LOCATION, "of three", KITCHEN)
        third_store.store.put(AREA, "hall", Map2DArea("m1", [], "hall"))
        third_store.store.put(LOCATION, "common1", KITCHEN)  # later than the deletion in "one"
        assert names(second_store) != names(first_store)
        with caplog.at_level(logging.WARNING):
            third_store.disconnect()
            for store in (second_store, third_store):
                store.join(first.endpoint)
            until(lambda: same(first_store, second_store, third_store), "all have the same content again", SECONDS)
        expected = sorted(
            {f"common{n}" for n in range(20)} - {"common2", "common3"} | {"both", "of one", "of two", "of three"}
        )
        for store in (first_store, second_store, third_store):
            assert names(store) == expected
            both = store.store.get(LOCATION, "both")
            assert both is not None
            assert both.x == 2.0
            assert store.store.names(MAP) == ["m1"]
            assert store.store.names(AREA) == ["hall"]
        lost = {record.getMessage() for record in caplog.records if "concurrently" in record.getMessage()}
        messages = [
            next(text for text in lost if f"location '{name}'" in text) for name in ("both", "common1", "common3")
        ]
        assert "at two and at one" in messages[0]
        assert '"x": 2.0' in messages[0]
        assert '"x": 1.0' in messages[0]
        assert "at three and at one" in messages[1]
        assert "deleted" in messages[1]
        assert "at two and at one" in messages[2]
        assert len({text for text in lost if "location 'common" in text or "both" in text}) == len(lost)


def test_a_deletion_reaches_a_replica_that_was_disconnected(hub: QuickHub, tmp_path: Path) -> None:
    with Shared(tmp_path, "one", hub.endpoint) as first_store, Shared(tmp_path, "two", hub.endpoint) as second_store:
        for number in range(300):  # more than one batch
            first_store.store.put(LOCATION, f"l{number}", KITCHEN)
        until(lambda: len(names(second_store)) == 300, "all values have arrived", SECONDS)
        second_store.disconnect()
        first_store.store.clear(LOCATION)
        second_store.join(hub.endpoint)
        until(lambda: not names(second_store), "all values are deleted", SECONDS)
        assert same(first_store, second_store)
        assert second_store.replica.status().conflicts == 0


def test_a_subscriber_of_all_puts_and_deletes_has_the_same_content(hub: QuickHub, tmp_path: Path) -> None:
    """The storage manager of zenohd does this: for each key, it stores the value with the latest timestamp."""
    held: dict[str, tuple[int, str, bytes | None]] = {}

    def keep(sample: zenoh.Sample) -> None:
        ns, writer = sample.timestamp.get_time_as_ntp64().as_nanos(), bytes(sample.timestamp.get_id()).hex()
        body = sample.payload.to_bytes() if sample.kind == zenoh.SampleKind.PUT else None
        key = str(sample.key_expr).removeprefix("midspan/store/0/")
        if key not in held or held[key][:2] < (ns, writer):
            held[key] = ns, writer, body

    with (
        Shared(tmp_path, "one", hub.endpoint) as first_store,
        Shared(tmp_path, "two", hub.endpoint) as second_store,
        plain(hub) as session,
        session.declare_subscriber("midspan/store/**", keep),
    ):
        all_joined(first_store, second_store)
        for store, name in ((first_store, "a"), (second_store, "b")):  # repeated until zenoh has the route
            until(
                lambda store=store, name=name: store.store.put(LOCATION, name, KITCHEN) or f"location/{name}" in held,
                "the listener receives the value",
                SECONDS,
            )
        first_store.store.put(MAP, "m1", grid())
        until(lambda: same(first_store, second_store), "both stores have the same content", SECONDS)
        second_store.store.delete(LOCATION, "a")
        until(
            lambda: len(held) == 3 and same(first_store, second_store) and held["location/a"][2] is None,
            "all changes have arrived",
            SECONDS,
        )
        for (kind, name), (stamp, _) in first_store.replica.versions().items():
            entry = first_store.replica.entry(kind, name)
            assert held[f"{kind}/{name}"] == (stamp.ns, stamp.replica, entry.body if entry else None)


def test_any_zenoh_program_reads_and_writes(hub: QuickHub, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with Shared(tmp_path, "one", hub.endpoint) as first_store, plain(hub) as session:
        first_store.store.put(LOCATION, "kitchen", KITCHEN)
        first_store.store.put(LOCATION, "hall", KITCHEN)
        first_store.store.put(MAP, "m1", grid())
        first_store.store.delete(LOCATION, "hall")
        replies = until(lambda: list(session.get("midspan/store/0/location/kitchen")), "there is a reply", SECONDS)
        assert json.loads(replies[0].ok.payload.to_bytes()) == {
            "map": "m1", "x": 1.0, "y": 2.5, "theta_deg": 90.0, "description": 'the "kitchen", große',
        }  # fmt: skip
        assert str(replies[0].ok.encoding) == "application/json"
        keys = {str(reply.ok.key_expr): reply.ok for reply in session.get("midspan/store/**")}
        assert set(keys) == {"midspan/store/0/location/kitchen", "midspan/store/0/map/m1"}
        stamp = keys["midspan/store/0/location/kitchen"].timestamp
        version = first_store.replica.versions()["location", "kitchen"][0]
        assert (stamp.get_time_as_ntp64().as_nanos(), bytes(stamp.get_id()).hex()) == (version.ns, version.replica)
        head, _, cells = keys["midspan/store/0/map/m1"].payload.to_bytes().partition(b"\n")
        about = json.loads(head)
        assert (about["width"], about["height"], about["occupancy"] + about["flags"]) == (20, 30, len(cells))

        session.put("midspan/store/0/location/door", b'{"map": "m1", "x": 4}')
        until(
            lambda: first_store.store.get(LOCATION, "door") == Map2DLocation("m1", 4.0), "the value is merged", SECONDS
        )
        session.delete("midspan/store/0/location/kitchen")
        until(lambda: names(first_store) == ["door"], "the value is deleted", SECONDS)
        with caplog.at_level(logging.WARNING):
            for key, body in (
                ("midspan/store/0/location/bad", b"[]"),
                ("midspan/store/0/map/bad", b'{"midspan": "map", "version": 1, "width": 1000000000, "height": 9}\n'),
                ("midspan/store/0/nothing/bad", b"{}"),
                ("midspan/store/0/location/@bad", b"{}"),
                ("midspan/store/0/location/.bad", b"{}"),
            ):
                session.put(key, body)
            session.put("midspan/store/0/location/good", b"{}")
            until(lambda: "good" in names(first_store), "the valid value is merged", SECONDS)
        assert names(first_store) == ["door", "good"]
        assert first_store.store.names(MAP) == ["m1"]
        assert len([1 for record in caplog.records if "is not merged" in record.getMessage()]) >= 3


def test_a_client_reads_its_own_writes(hub: QuickHub, tmp_path: Path) -> None:
    with Hub.open(hub.settings("cli")) as session:
        space = session.keyspace(prefix(0))
        with pytest.raises(StoreError, match=r"set store\.enabled to true"):
            StoreClient(space, "two")
        with (
            Shared(tmp_path, "one", hub.endpoint) as first_store,
            Shared(tmp_path, "two", hub.endpoint) as second_store,
        ):
            all_joined(first_store, second_store)
            client = until(lambda: wanted(space, "two"), "the daemon's own replica is found", SECONDS)
            area = Map2DArea("m1", [], "hall")
            client.write([Write(LOCATION, "a b", KITCHEN), Write(MAP, "m1", grid()), Write(AREA, "hall", area)])
            assert second_store.store.get(LOCATION, "a b") == KITCHEN
            assert client.get(LOCATION, "a b") == KITCHEN
            assert client.all(MAP) == {"m1": grid()}
            client.use_map("m1")
            assert client.current_map() == "m1"
            until(lambda: first_store.store.current_map() == "m1", "the other daemon has the current map too", SECONDS)
            client.write([Write(LOCATION, "a b", None), Write(LOCATION, "never", None)])
            assert client.names(LOCATION) == []
            assert client.get(LOCATION, "a b") is None
            second_store.store.put(BEHAVIOR, "hall", AreaBehavior(keep_out=True))
            client.write([Write(AREA, "hall", None)])
            assert second_store.store.names(BEHAVIOR) == []
            for bad, reason in (
                (Write(LOCATION, "a/b", KITCHEN), "the name 'a/b' has /"),
                (Write(LOCATION, "a", Map2DLocation("m1", float("inf"))), "cannot be represented in JSON"),
            ):
                with pytest.raises(StoreError, match=reason):
                    client.write([bad])
            with pytest.raises(StoreError, match="no map 'm2'; existing maps: m1"):
                client.use_map("m2")
            second_store.replica.limits = StoreLimits(keys=1)
            with pytest.raises(StoreError, match=r"store\.keys"):
                client.write([Write(LOCATION, "one more", KITCHEN)])


@pytest.mark.usefixtures("patient")
def test_a_change_is_based_on_the_newest_version(hub: QuickHub, tmp_path: Path) -> None:
    with Hub.open(hub.settings("cli")) as session, Shared(tmp_path, "one", hub.endpoint) as first_store:
        client = StoreClient(session.keyspace(prefix(0)), "one")
        first_store.store.put(LOCATION, "kitchen", KITCHEN)
        seen = []

        def moved() -> list[Write[Any]]:
            replies = client.get(LOCATION, "kitchen")
            assert replies is not None
            seen.append(replies.x)
            if len(seen) == 1:  # another client writes between reading and writing
                first_store.store.put(LOCATION, "kitchen", replace(replies, y=7.0))
            return [Write(LOCATION, "kitchen", replace(replies, x=replies.x + 1.0))]

        client.change(moved)
        assert len(seen) == 2
        assert first_store.store.get(LOCATION, "kitchen") == replace(KITCHEN, x=KITCHEN.x + 1.0, y=7.0)
        with pytest.raises(StoreError, match="other clients keep changing the same keys"):
            client.change(lambda: (first_store.store.put(LOCATION, "new", KITCHEN), [Write(LOCATION, "new", None)])[1])
        assert first_store.store.get(LOCATION, "new") == KITCHEN


@pytest.mark.usefixtures("patient")
def test_a_client_renames_a_map_with_its_places(hub: QuickHub, tmp_path: Path) -> None:
    with Hub.open(hub.settings("cli")) as session, Shared(tmp_path, "one", hub.endpoint) as first_store:
        client, store = StoreClient(session.keyspace(prefix(0)), "one"), first_store.store
        corners = [Vec2D(0, 0), Vec2D(1, 0), Vec2D(1, 1)]
        elsewhere = replace(KITCHEN, map_id="m2")
        path = Map2DPath([KITCHEN, elsewhere])
        store.write([
            Write(MAP, "m1", grid()), Write(LOCATION, "kitchen", KITCHEN), Write(LOCATION, "far", elsewhere),
            Write(AREA, "hall", Map2DArea("m1", corners)), Write(BEHAVIOR, "hall", AreaBehavior(keep_out=True)),
            Write(PATH, "way", path),
        ])  # fmt: skip
        store.use_map("m1")
        client.rename(MAP, "m1", "house")
        client.rename(AREA, "hall", "big hall")
        assert (store.names(MAP), store.current_map()) == (["house"], "house")
        moved_kitchen = replace(KITCHEN, map_id="house")
        assert store.all(LOCATION) == {"kitchen": moved_kitchen, "far": elsewhere}
        assert store.all(AREA) == {"big hall": Map2DArea("house", corners)}
        assert store.all(BEHAVIOR) == {"big hall": AreaBehavior(keep_out=True)}
        assert store.get(PATH, "way") == Map2DPath([moved_kitchen, elsewhere])
        for old, new, reason in (("none", "x", "no location 'none'"), ("far", "kitchen", "exists already")):
            with pytest.raises(StoreError, match=reason):
                client.rename(LOCATION, old, new)


@pytest.mark.usefixtures("patient")
def test_a_client_waits_for_a_store_that_starts_later(hub: QuickHub, tmp_path: Path) -> None:
    with Hub.open(hub.settings("cli")) as session, ThreadPoolExecutor() as pool:
        space = session.keyspace(prefix(0))
        client = pool.submit(StoreClient, space, "one")
        with Shared(tmp_path, "one", hub.endpoint):
            assert client.result(SECONDS).daemon == "one"


def test_invalid_queries_and_samples_are_refused(hub: QuickHub, tmp_path: Path) -> None:
    with Shared(tmp_path, "one", hub.endpoint) as first_store, plain(hub) as session:
        zid = first_store.hub.zid if first_store.hub else ""
        write = f"midspan/store/0/@sync/write/{zid}"
        until(lambda: [r.err for r in session.get(write, payload=b"")], "the store responds", SECONDS)
        for body in (
            b"",
            b"{}",
            b"[" * 100_000,
            b'{"writes": 1}\n',
            b'{"writes": [], "stamps": 1}\n',
            b'{"writes": [], "stamps": {"../a": null}}\n',
            b'{"writes": [1]}\n',
            b'{"writes": [{"key": "location/a", "size": -1}]}\n',
            b'{"writes": [{"key": "location/a", "size": 1000}]}\n{}',
            b'{"writes": [{"key": "location/a", "size": 2}]}\n{}{}',
            b'{"writes": [{"key": "location/../a", "size": 2}]}\n{}',
            b'{"writes": [{"key": "nothing/a", "size": 2}]}\n{}',
            b'{"writes": [{"key": "location/a", "size": 2}]}\n[]',
        ):
            replies = list(session.get(write, payload=body))
            assert [reply.err is not None for reply in replies] == [True], body
        stale = b'{"writes": [{"key": "location/a", "size": 2}], "stamps": {"location/a": [1, {}]}}\n{}'
        answers = [reply.ok.payload.to_bytes() for reply in session.get(write, payload=stale) if reply.ok]
        assert answers == [b'{"stale": true}']
        for verb in ("digest", "fetch"):
            for body in (b"", b"[]", b'{"digests": 1, "keys": 1}', b'{"digests": [1], "keys": ["a/b/c"]}'):
                suffix = "/**" if verb == "fetch" else ""
                replies = list(session.get(f"midspan/store/0/@sync/{verb}/{zid}{suffix}", payload=body))
                assert [reply.err is not None for reply in replies] == [True], body
        for attachment in (
            b"{",
            b"a" * 10_000,
            b"{}",
            json.dumps({"ns": 2**62, "replica": "aa", "origin": "x", "seen": {}}).encode(),
            json.dumps({"ns": 1, "replica": "zz", "origin": "x", "seen": {}}).encode(),
            json.dumps({"ns": 1, "replica": "aa", "origin": "\x1b[2J", "seen": {}}).encode(),
            json.dumps({"ns": 1, "replica": "aa", "origin": "x", "seen": {"aa": "1"}}).encode(),
            json.dumps(
                {"ns": 1, "replica": "aa", "origin": "x", "seen": {f"{n:04x}": n for n in range(1, 99)}}
            ).encode(),
        ):
            session.put("midspan/store/0/location/bad", b"{}", attachment=attachment)
        session.put("midspan/store/0/location/good", b"{}")
        until(lambda: names(first_store), "the valid value is merged", SECONDS)
        assert names(first_store) == ["good"]


def wanted(space: KeySpace, daemon: str) -> StoreClient | None:
    """Return a client of a daemon's own replica, or None while the replica is not discovered."""
    with contextlib.suppress(StoreError):
        client = StoreClient(space, daemon)
        return client if client.daemon == daemon else None
    return None


@contextlib.contextmanager
def plain(hub: QuickHub) -> Iterator[zenoh.Session]:
    """Open a session of a plain zenoh program: a client of the router, with zenoh's defaults but no scouting."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([hub.endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        yield session


def test_a_replica_of_another_major_version_is_not_merged(
    hub: QuickHub, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with Shared(tmp_path, "one", hub.endpoint) as first_store, plain(hub) as session:
        queries: list[bytes] = []

        def digest(query: zenoh.Query) -> None:
            queries.append(query.payload.to_bytes() if query.payload else b"")
            entries = [["location", "strange", 7, "aa", 2]]
            query.reply(query.key_expr, json.dumps({"wire": "2.0", "entries": entries}))

        zid = str(session.zid())
        kept = session.declare_queryable(f"midspan/store/0/@sync/digest/{zid}", digest, complete=True)
        with caplog.at_level(logging.WARNING):
            token = session.liveliness().declare_token(f"midspan/store/0/@sync/alive/{zid}/far")
            until(lambda: "the store of far is not merged" in caplog.text, "the other store is refused", SECONDS)
        assert caplog.text.count("the store of far is not merged: it uses version 2.0") == 1
        assert json.loads(queries[0])["wire"] == WIRE
        version = {"ns": 7, "replica": "aa", "origin": "far", "seen": {}}
        for name, wire in (("strange", "2.0"), ("later", "1.7")):
            attachment = json.dumps({**version, "wire": wire, "more": 1}).encode()
            session.put(f"midspan/store/0/location/{name}", b"{}", attachment=attachment)
        until(lambda: names(first_store), "the value of a later minor version is merged", SECONDS)
        assert names(first_store) == ["later"]
        assert "location/strange is not merged: it uses version 2.0" in caplog.text
        assert first_store.hub is not None
        question = f"midspan/store/0/@sync/digest/{first_store.hub.zid}"
        (refused,) = session.get(question, payload=b'{"wire": "2.0", "digests": []}')
        assert b"uses version 2.0" in refused.err.payload.to_bytes()
        (taken,) = session.get(question, payload=b'{"wire": "1.7", "digests": [], "more": 1}')
        assert json.loads(taken.ok.payload.to_bytes())["wire"] == WIRE
        for declared in (kept, token):
            declared.undeclare()
