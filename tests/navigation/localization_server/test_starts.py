"""A start pose on another map switches to that map and keeps its uncertainty."""

from __future__ import annotations

import logging
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import Mock

import numpy as np
import pytest

from bridge.clock import RunClock, SystemClock
from bridge.modules.host import Host
from navigation.localization_server.estimate import plane_of, pose_of
from navigation.localization_server.module import LocalizationServer
from navigation.localization_server.section import LocalizationServerSection
from navigation.localization_server.sources import Start
from navigation.pose import Pose
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D

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
        self.subscribers = ["amcl"]
        graph = SimpleNamespace(subscriptions=lambda _topic: self.subscribers)
        self.node = SimpleNamespace(
            hub=SimpleNamespace(graph=graph),
            subscription=lambda *_: None,
            subscription_cdr=lambda *_, **_more: None,
            publisher=lambda topic, *_, **_more: SimpleNamespace(
                publish=lambda message: self.sent.append((topic, message))
            ),
            client=lambda name, *_: SimpleNamespace(
                ready=True, call=lambda request, _: self.sent.append((name, request))
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
