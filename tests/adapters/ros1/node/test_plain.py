"""The plain node's connections to publishers."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future

import pytest

from bridge.adapters.ros1.node import plain
from bridge.adapters.ros1.node.address import NodeAddress
from bridge.adapters.ros1.node.plain import PlainNode, PlainNodeEvents
from bridge.messages.transcode.conversion import SideType
from tests.support.ports import free_port

TEXT = SideType("std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1", "string data\n")


def test_an_old_list_of_publishers_does_not_replace_a_newer_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A master's updates arrive on several threads, and the master does not repeat the last one."""
    monkeypatch.setattr(plain, "_RETRY_SECONDS", 600.0)
    publisher = f"http://127.0.0.1:{free_port()}/"
    listing, newer_requested = threading.Event(), threading.Event()

    def publishers(_topic: str) -> list[str]:
        if listing.is_set():
            return [publisher]
        listing.set()
        newer_requested.wait(60)
        return []

    events = PlainNodeEvents(publishers, lambda: None, lambda _: None)
    node = PlainNode("/plain", "http://127.0.0.1:1/", NodeAddress("127.0.0.1", "127.0.0.1", False), events)
    submit, jobs = node._pool.submit, list[Future[object]]()

    def record(job: Callable[[], object]) -> Future[object]:
        jobs.append(submit(job))
        return jobs[-1]

    monkeypatch.setattr(node._pool, "submit", record)
    try:
        node.subscribe("/topic", TEXT, lambda *_: None)
        node.follow()
        assert listing.wait(60)
        node.follow()
        jobs[1].result(60)
        newer_requested.set()
        jobs[0].result(60)
        assert set(node._subscriptions["/topic"].readers) == {publisher}
    finally:
        newer_requested.set()
        node.close()
