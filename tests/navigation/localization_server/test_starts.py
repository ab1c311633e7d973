"""An initial pose on another map switches to that map and keeps its uncertainty."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import Mock

import numpy as np
import pytest

from bridge.clock import RunClock, SystemClock
from bridge.modules.host import Host
from navigation.localization_server.estimate import LocalizationStatus, plane_of, pose_of
from navigation.localization_server.module import LocalizationServer
from navigation.localization_server.section import LocalizationServerSection
from navigation.localization_server.sources import Start
from navigation.pose import Pose
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D

PREVIOUS = "amcl still has the previous map"
START = Start(Pose(0.5, 0.25, 1.0), np.diag([0.0004, 0.0009, 0.0001]))


def grid(name: str) -> MapGrid2D:
    flags = np.zeros((20, 20), np.uint8)
    flags[0] = MapFlag.WALL
    return MapGrid2D.of(flags, name=name, resolution=0.1)


class Outside:
    """A host for sources and the module, which records the messages that they send."""

    def __init__(self, folder: Path) -> None:
        self.maps = {name: grid(name) for name in ("house", "cellar")}
        self.current, self.folder, self.log = "house", folder, logging.getLogger(__name__)
        self.sent: list[tuple[str, dict[str, Any]]] = []
        self.subscribers, self.ready = ["amcl"], True
        self.replies: list[Callable[[dict[str, Any]], None]] = []
        graph = SimpleNamespace(subscriptions=lambda _topic: self.subscribers)
        self.node = SimpleNamespace(
            hub=SimpleNamespace(graph=graph),
            subscription=lambda *_: None,
            subscription_cdr=lambda *_, **_more: None,
            publisher=lambda topic, *_, **_more: SimpleNamespace(
                publish=lambda message: self.sent.append((topic, message))
            ),
            client=lambda name, *_: SimpleNamespace(
                ready=self.ready,
                call=lambda request, replied: (self.sent.append((name, request)), self.replies.append(replied)),
            ),
        )
        self.clock = SimpleNamespace(now_ns=lambda: 0, stamp=lambda: {"sec": 0, "nanosec": 0}, on_jump=lambda _: None)
        self.yarp, self.loop = Mock(), Mock()
        self.on_jump = self.every = lambda *_: None
        self.store = SimpleNamespace(
            use_map=lambda name: setattr(self, "current", name),
            current_map=lambda: self.current,
            get=lambda _kind, name: self.maps[name],
            watch=lambda *_: lambda: None,
        )

    def module(self, **section: Any) -> LocalizationServer:
        """Return the module, started on the first map."""
        module, host = LocalizationServer(), cast("Host", self)
        module.start(host, LocalizationServerSection(**section))
        return module


@pytest.fixture
def outside(tmp_path: Path) -> Outside:
    return Outside(tmp_path)


def test_our_localizer_starts_with_the_given_uncertainty(outside: Outside) -> None:
    module: Any = outside.module()
    module.begin(*START, "cellar")
    estimate = module.estimate()
    assert module.map_name == "cellar"
    assert estimate.pose[:3] == pytest.approx(START.pose[:3], abs=0.02)
    assert np.diag(estimate.covariance) == pytest.approx(np.diag(START.covariance), rel=0.5)


@pytest.mark.parametrize(
    ("set_map", "before", "receiver"),
    [("/set_map", "house", "/set_map"), ("/set_map", "", "/initialpose"), ("", "house", "/initialpose")],
    ids=["another map", "amcl loads the first map itself", "amcl follows /map"],
)
def test_the_start_is_sent_to_amcl(outside: Outside, set_map: str, before: str, receiver: str) -> None:
    outside.current = before
    module = outside.module(source="amcl", set_map=set_map)
    module.begin(*START, "cellar")
    ((name, message),) = outside.sent
    assert name == receiver
    start = message.get("initial_pose", message)["pose"]
    assert pose_of(start["pose"])[:3] == pytest.approx(START.pose[:3])
    assert plane_of(start["covariance"]) == pytest.approx(START.covariance)


def localized(module: LocalizationServer, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Let amcl publish a pose; return a list with the stamp of its newest transform."""
    stamp = [1]
    for name in ("pose", "correction"):
        monkeypatch.setattr(module._frames, name, lambda: Pose(1.0, 2.0, 0.0, stamp[0]))
    assert module.estimate().status is LocalizationStatus.OK
    return stamp


def unknown_pose(module: LocalizationServer) -> str:
    """Return why the pose is not reliable."""
    estimate = module.estimate()
    assert estimate.status is LocalizationStatus.NOT_YET
    return estimate.reason


def test_the_pose_counts_on_another_map_only_after_amcl_has_published_one_there(
    outside: Outside, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = outside.module(source="amcl")
    stamp = localized(module, monkeypatch)
    module.begin(*START, "cellar")
    stamp[0] += 1  # amcl still publishes transforms on the previous map
    assert unknown_pose(module) == f"{PREVIOUS}: /set_map has not answered"
    (replied,) = outside.replies
    replied({"success": True})
    assert "has not published its pose on that map" in unknown_pose(module)
    stamp[0] += 1
    assert module.estimate().status is LocalizationStatus.OK


def test_a_reply_for_a_replaced_map_does_not_count(outside: Outside, monkeypatch: pytest.MonkeyPatch) -> None:
    outside.maps["attic"] = grid("attic")
    outside.maps["attic"].flags[:, 0] = MapFlag.WALL
    module = outside.module(source="amcl")
    stamp = localized(module, monkeypatch)
    for name in ("cellar", "attic"):
        module.begin(*START, name)
    outside.replies[0]({"success": True})
    stamp[0] += 1
    assert unknown_pose(module).startswith(PREVIOUS)


def test_the_pose_on_the_previous_map_does_not_count_while_amcls_service_is_missing(
    outside: Outside, monkeypatch: pytest.MonkeyPatch
) -> None:
    outside.ready = False
    module = outside.module(source="amcl")
    localized(module, monkeypatch)
    module.begin(*START, "cellar")
    assert unknown_pose(module).startswith(f"{PREVIOUS}: /set_map is not available; ")


def test_a_start_pose_without_a_subscriber_is_rejected(outside: Outside) -> None:
    outside.subscribers = []
    module = outside.module(source="amcl", set_map="")
    with pytest.raises(RuntimeError, match="no subscriber to /initialpose"):
        module.begin(*START, "cellar")


@pytest.mark.parametrize("jump", [-3600, 3600])
def test_a_pose_from_a_topic_stays_known_if_the_system_clock_is_set(outside: Outside, jump: int) -> None:
    now = [1_790_000_000_000_000_000]
    clock: Any = RunClock(system=SystemClock(lambda: now[0], poll=0))
    outside.clock = clock
    source: Any = outside.module(source="topic").source
    source.set_pose(START.pose)
    now[0] += jump * 1_000_000_000
    source.on_clock_jump()
    assert source.estimate().pose[:3] == START.pose[:3]


def test_a_pose_from_a_topic_is_unknown_after_a_simulation_restarts(outside: Outside) -> None:
    clock: Any = RunClock(simulated=True)
    outside.clock = clock
    source: Any = outside.module(source="topic").source
    source.set_pose(START.pose)
    assert source.estimate().pose is not None
    source.on_clock_jump()
    assert source.estimate().pose is None
