"""What is told of an endpoint of ours, and when."""

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


def test_it_is_told_once_and_taken_back_once() -> None:
    said: list[str] = []

    def tell() -> Callable[[], None]:
        said.append("here")
        return lambda: said.append("gone")

    told = Announcement(tell)
    told.publish()
    told.withdraw()
    told.withdraw()
    assert said == ["here", "gone"]


def test_what_closed_before_is_not_told() -> None:
    said: list[str] = []
    told = Announcement(lambda: lambda: said.append("gone"))
    told.withdraw()
    told.publish()
    told.withdraw()
    assert said == []


@pytest.mark.parametrize("dialect", MODULES)
def test_an_endpoint_is_there_before_it_is_told(place: Place, monkeypatch: pytest.MonkeyPatch, dialect: str) -> None:
    """Who hears of a server calls at once, and who hears of a subscriber publishes."""
    done: list[str] = []
    module, announcer = MODULES[dialect]
    noted = functools.partial(_noted, monkeypatch, done)
    noted(module, "KeyServer", "served")
    noted(KeySubscription, "__init__", "subscribed")
    noted(announcer, "announce", "told")
    place.bridge({"dialect": dialect})
    place.far.serve("/do", "std_srvs/SetBool", reply={"success": True, "message": "yes"})
    until(lambda: len(done) == 2, "the service is there and told")
    assert done == ["served", "told"]
    programs = place.ros2dds() if dialect == "ros2dds" else place.ros1()
    programs.advertise("/chatter", "std_msgs/String")
    place.far.subscribe("/chatter", "std_msgs/String")
    until(lambda: len(done) == 4, "the topic is heard and told")
    assert done[2:] == ["subscribed", "told"]


def _noted(monkeypatch: pytest.MonkeyPatch, done: list[str], owner: Any, name: str, word: str) -> None:
    real = getattr(owner, name)

    def noting(*args: Any, **more: Any) -> Any:
        made = real(*args, **more)
        done.append(word)
        return made

    monkeypatch.setattr(owner, name, noting)
