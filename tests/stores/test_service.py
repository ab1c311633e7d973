"""The store of the modules' worker, which is opened when needed, and appears in the worker's status."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import pytest

from bridge.config.digests import digest_of
from bridge.config.model import Config
from bridge.config.sections.section import Section
from bridge.daemon.workers import worker_kinds
from bridge.hub.errors import HubError
from bridge.modules.host import Host
from bridge.modules.module import Module
from bridge.modules.shared import Shared
from bridge.modules.worker import ModulesWorker
from bridge.stores.entry import StoreError
from bridge.stores.kinds import LOCATION
from bridge.stores.service import StoreService
from tests.peers.hub.modules import Place
from tests.stores.test_store import KITCHEN
from tests.support.wait import until
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.places import Places

OWN = {"name": "keeper", "factory": "tests.stores.test_service:Keeper"}


class Keeper(Module):
    """Reports received changes of the store in its status."""

    name: ClassVar[str] = "keeper"

    def start(self, host: Host, section: Section) -> None:  # noqa: ARG002
        self._received: list[str] = []
        store = host.store
        self._close = store.watch(lambda change: host.loop.post(lambda: self._received.append(change.name)))
        store.put(LOCATION, "kitchen", KITCHEN)

    def status(self) -> dict[str, Any]:
        return {"received": list(self._received)}

    def stop(self) -> None:
        self._close()


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Place]:
    with Place(tmp_path) as rig_:
        yield rig_


def test_a_module_uses_the_store_and_the_status_shows_it(rig: Place) -> None:
    rig.worker.start(rig.config(OWN))
    until(lambda: (rig.status("keeper") or {}).get("received") == ["kitchen"], "the module receives the change")
    status = until(lambda: rig.status("store"), "the store reports its status")
    assert status["text"] == "1 location; not shared"
    assert status["store"]["keys"] == {"location": 1}
    assert (rig.folder / "here" / "store.sqlite").exists()


def test_the_store_runs_without_modules(rig: Place) -> None:
    config = rig.config(store={"enabled": True})
    assert worker_kinds()["modules"].enabled(config)
    assert not worker_kinds()["modules"].enabled(rig.config())
    rig.worker.start(config)
    assert (rig.worker.health().state, rig.worker.health().text) == ("running", "store")
    until(lambda: rig.status("store"), "the store reports its status")


def test_a_reload_imports_new_values_of_changed_files(rig: Place, tmp_path: Path) -> None:
    places = {"kitchen": KITCHEN}
    Places(places, {}, {}).save(file := tmp_path / "locations.ini")

    def config() -> Config:
        configured = rig.config(OWN, store={"enabled": True, "locations": file})
        configured.store.set_digest(digest_of(configured.store.named_files()))  # as the daemon loads it
        return configured

    rig.worker.start(config())
    store, module = rig.worker.store, rig.worker.running("keeper").module
    store.put(LOCATION, "kitchen", moved := Map2DLocation("m1", 9.0))
    Places({**places, "hall": Map2DLocation("m2", 1.0)}, {}, {}).save(file)
    assert rig.worker.reload(config())
    assert store.names(LOCATION) == ["hall", "kitchen"]
    assert store.get(LOCATION, "kitchen") == moved, "an import replaces no value"
    assert rig.worker.running("keeper").module is module, "modules keep running"


def test_a_disabled_store_or_one_in_use_is_reported(rig: Place) -> None:
    rig.worker.start(rig.config(OWN, store={"enabled": False}))
    health = rig.worker.health()
    assert (health.state, health.text) == ("waiting", "keeper waiting: the store is disabled (store.enabled)")
    rig.worker.stop()
    config = rig.config(store={"enabled": True})
    holder = Shared(config)
    assert holder.stores.trouble() == ""
    try:
        other = ModulesWorker()
        other.start(config)
        health = other.health()
        assert health.state == "waiting"
        assert "in use by another process" in health.text

        def shown() -> bool:
            answers = rig.far.hub.ask("status", {}, worker="store")
            return any("in use by another process" in str(answer.value) for answer in answers)

        until(shown, "the status of the store reports it")
    finally:
        holder.close()
    assert other.health().state == "running"
    other.stop()


def test_a_module_in_a_separate_process_has_its_own_replica(rig: Place) -> None:
    config = rig.config(OWN, store={"enabled": True})
    daemon = Shared(config.model_copy(update={"modules": Config().modules}))
    alone = ModulesWorker("keeper")
    try:
        store = daemon.stores.store
        alone.start(config)
        until(lambda: store.names(LOCATION) == ["kitchen"], "the module's value has arrived")
    finally:
        alone.stop()
        daemon.close()
    assert {file.name for file in (rig.folder / "here").glob("store*.sqlite")} == {
        "store.sqlite",
        "store-keeper.sqlite",
    }


class Node:
    """A hub node whose keyspace fails, as if the router had disconnected."""

    def __init__(self) -> None:
        self.closed = False

    def keyspace(self, _prefix: str) -> Any:
        raise HubError("the router has left")

    def close(self) -> None:
        self.closed = True


def test_a_store_that_cannot_join_the_hub_is_unavailable_and_opened_later(rig: Place) -> None:
    node = Node()
    nodes: list[Any] = [HubError("no router at tcp/127.0.0.1:1"), node]

    daemon = Shared(rig.config())

    def join(name: str, worker: str) -> Any:
        first = nodes.pop(0) if nodes else daemon.join(name, worker)
        if isinstance(first, HubError):
            raise first
        return first

    service = StoreService(rig.config(), "", join)
    for reason in ("no router", "the router has left"):
        with pytest.raises(StoreError, match=f"the store cannot join the hub: {reason}"):
            _ = service.store
    assert node.closed
    try:
        service.store.put(LOCATION, "kitchen", KITCHEN)
    finally:
        service.close()
        daemon.close()
