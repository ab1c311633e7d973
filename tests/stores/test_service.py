"""The store of the modules' worker: opened if wanted, shown in the status, used by modules."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import pytest

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

OWN = {"name": "keeper", "factory": "tests.stores.test_service:Keeper"}


class Keeper(Module):
    """Reports received changes of the store in its status."""

    name: ClassVar[str] = "keeper"

    def start(self, host: Host, section: Section) -> None:  # noqa: ARG002
        self._heard: list[str] = []
        store = host.store
        self._close = store.watch(lambda change: host.loop.post(lambda: self._heard.append(change.name)))
        store.put(LOCATION, "kitchen", KITCHEN)

    def status(self) -> dict[str, Any]:
        return {"heard": list(self._heard)}

    def stop(self) -> None:
        self._close()


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    with Place(tmp_path) as place_:
        yield place_


def test_a_module_uses_the_store_and_the_status_shows_it(place: Place) -> None:
    place.worker.start(place.config(OWN))
    until(lambda: (place.status("keeper") or {}).get("heard") == ["kitchen"], "the module receives the change")
    status = until(lambda: place.status("store"), "the store reports its status")
    assert status["text"] == "1 location; not shared"
    assert status["store"]["keys"] == {"location": 1}
    assert (place.folder / "here" / "store.sqlite").exists()


def test_the_store_runs_without_modules(place: Place) -> None:
    config = place.config(store={"enabled": True})
    assert worker_kinds()["modules"].enabled(config)
    assert not worker_kinds()["modules"].enabled(place.config())
    place.worker.start(config)
    assert (place.worker.health().state, place.worker.health().text) == ("running", "store")
    until(lambda: place.status("store"), "the store reports its status")


def test_a_disabled_store_or_one_in_use_is_reported(place: Place) -> None:
    place.worker.start(place.config(OWN, store={"enabled": False}))
    health = place.worker.health()
    assert (health.state, health.text) == ("waiting", "keeper waiting: the store is disabled (store.enabled)")
    place.worker.stop()
    config = place.config(store={"enabled": True})
    holder = Shared(config)
    assert holder.stores.trouble() == ""
    try:
        other = ModulesWorker()
        other.start(config)
        health = other.health()
        assert health.state == "waiting"
        assert "in use by another process" in health.text

        def shown() -> bool:
            answers = place.far.hub.ask("status", {}, worker="store")
            return any("in use by another process" in str(answer.value) for answer in answers)

        until(shown, "the status of the store reports it")
    finally:
        holder.close()
    assert other.health().state == "running"
    other.stop()


def test_a_module_in_a_separate_process_has_its_own_replica(place: Place) -> None:
    config = place.config(OWN, store={"enabled": True})
    daemon = Shared(config.model_copy(update={"modules": Config().modules}))
    alone = ModulesWorker("keeper")
    try:
        store = daemon.stores.store
        alone.start(config)
        until(lambda: store.names(LOCATION) == ["kitchen"], "the module's value has arrived")
    finally:
        alone.stop()
        daemon.close()
    assert {file.name for file in (place.folder / "here").glob("store*.sqlite")} == {
        "store.sqlite",
        "store-keeper.sqlite",
    }


class Node:
    """A node whose keyspace cannot be used at first."""

    def __init__(self) -> None:
        self.closed = False

    def keyspace(self, _prefix: str) -> Any:
        raise HubError("the router has left")

    def close(self) -> None:
        self.closed = True


def test_a_store_that_cannot_join_the_hub_is_unavailable_and_opened_later(place: Place) -> None:
    node = Node()
    nodes: list[Any] = [HubError("no router at tcp/127.0.0.1:1"), node]

    daemon = Shared(place.config())

    def join(name: str, worker: str) -> Any:
        first = nodes.pop(0) if nodes else daemon.join(name, worker)
        if isinstance(first, HubError):
            raise first
        return first

    service = StoreService(place.config(), "", join)
    for reason in ("no router", "the router has left"):
        with pytest.raises(StoreError, match=f"the store cannot join the hub: {reason}"):
            _ = service.store
    assert node.closed
    try:
        service.store.put(LOCATION, "kitchen", KITCHEN)
    finally:
        service.close()
        daemon.close()
