"""Endpoints are announced after they exist, and closed after their announcements are withdrawn."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import pytest

from bridge.adapters.zenoh import ros1, ros2dds
from bridge.adapters.zenoh.ros1_discovery import Aloha
from bridge.adapters.zenoh.ros2dds_graph import TokenAnnouncer
from bridge.adapters.zenoh.topics import Announcement, KeySubscription
from tests.adapters.zenoh.conftest import Place
from tests.support.wait import until

MODULES = {"ros2dds": (ros2dds, TokenAnnouncer), "ros1": (ros1, Aloha)}


def test_an_announcement_is_published_once_and_withdrawn_once() -> None:
    text: list[str] = []

    def announce() -> Callable[[], None]:
        text.append("here")
        return lambda: text.append("gone")

    reported = Announcement(announce)
    reported.publish()
    reported.withdraw()
    reported.withdraw()
    assert text == ["here", "gone"]


def test_an_endpoint_that_closed_before_is_not_announced() -> None:
    text: list[str] = []
    reported = Announcement(lambda: lambda: text.append("gone"))
    reported.withdraw()
    reported.publish()
    reported.withdraw()
    assert text == []


@pytest.mark.parametrize("dialect", MODULES)
def test_an_endpoint_exists_before_it_is_announced(place: Place, monkeypatch: pytest.MonkeyPatch, dialect: str) -> None:
    """A client that discovers a server calls at once, and a publisher that discovers a subscriber publishes at once."""
    done: list[str] = []
    module, announcer = MODULES[dialect]
    noted = functools.partial(_noted, monkeypatch, done)
    noted(module, "KeyServer", "served")
    noted(KeySubscription, "__init__", "subscribed")
    noted(announcer, "announce", "told")
    place.bridge({"dialect": dialect})
    place.far.serve("/do", "std_srvs/SetBool", reply={"success": True, "message": "yes"})
    until(lambda: len(done) == 2, "the service exists and is announced")
    assert done == ["served", "told"]
    programs = place.ros2dds() if dialect == "ros2dds" else place.ros1()
    programs.advertise("/chatter", "std_msgs/String")
    place.far.subscribe("/chatter", "std_msgs/String")
    until(lambda: len(done) == 4, "the topic is received and announced")
    assert done[2:] == ["subscribed", "told"]


def _noted(monkeypatch: pytest.MonkeyPatch, done: list[str], owner: Any, name: str, word: str) -> None:
    real = getattr(owner, name)

    def noting(*args: Any, **more: Any) -> Any:
        created = real(*args, **more)
        done.append(word)
        return created

    monkeypatch.setattr(owner, name, noting)
