"""What is known of publishers and servers is followed in the order in which it became known."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.adapters.ros1.actions.actions import Actions
from bridge.adapters.ros1.actions.parts import SERVICES
from bridge.adapters.ros1.edge import Ros1Edge
from bridge.adapters.ros1.graph import Link
from bridge.adapters.ros1.probe import Facts
from bridge.clock import SYSTEM
from bridge.config.model import Config
from bridge.messages.registry import Registry

NAMES = {"send_goal": "SendGoal", "get_result": "GetResult"}
LINK, FACTS = Link("/a", "/t", "http://a:1/"), Facts("m/T", "1", "", latching=False, native=True)


class LateProber:
    """Tells who asks first what was known before, and only when somebody else has followed what is known now."""

    def __init__(self, follow: Callable[[], None]) -> None:
        self._follow, self._asked = follow, 0

    def facts(self, _topic: str = "") -> Mapping[Link, Facts]:
        self._asked += 1
        if self._asked > 1:
            return {LINK: FACTS}
        self.other = threading.Thread(target=self._follow)
        self.other.start()
        self.other.join(0.2)  # one that waits for the first is not awaited
        return {}


@pytest.mark.parametrize("kind", ["subscription", "caller"])
def test_what_was_known_before_is_not_followed_after_what_is_known_now(tmp_path: Path, kind: str) -> None:
    edge = Ros1Edge(Config.model_validate({"name": "here", "ros1": {}}), Registry(), tmp_path)
    followed: list[Any] = []
    one = SimpleNamespace(topic="/t", name="/t", md5="1", follow=followed.append, close=lambda: None)
    services = edge._services
    if kind == "subscription":
        edge._subscriptions = [SimpleNamespace(subscription=one, close=lambda: None)]  # type: ignore[assignment]
        follow, owner, now = edge._follow_subscriptions, edge, {LINK: FACTS}
    else:
        services._callers = [one]  # type: ignore[assignment]
        follow, owner, now = services._follow, services, LINK
    owner._prober = LateProber(follow)  # type: ignore[assignment]
    try:
        follow()
        owner._prober.other.join()
    finally:
        edge.stop()
    assert len(followed) == 2
    assert followed[-1] == now


def test_what_becomes_known_of_one_topic_disturbs_no_other(tmp_path: Path) -> None:
    """With a thousand topics each of a thousand answers would have a thousand subscriptions look, else."""
    edge = Ros1Edge(Config.model_validate({"name": "here", "ros1": {}}), Registry(), tmp_path)
    followed: list[tuple[str, Any]] = []

    def one(topic: str) -> Any:
        return SimpleNamespace(
            topic=topic, name=topic, md5="1", close=lambda: None, follow=lambda known: followed.append((topic, known))
        )

    topics = ("/t", "/u")
    edge._subscriptions = [SimpleNamespace(subscription=one(t), close=lambda: None) for t in topics]  # type: ignore[assignment]
    edge._services._callers = [one(t) for t in topics]  # type: ignore[assignment]
    other = Link("/b", "/u", "http://b:1/")
    for prober in (edge._prober, edge._services._prober):
        prober._facts = {LINK: FACTS, other: FACTS}
        prober._changed(LINK)
    edge.stop()
    assert followed == [("/t", {LINK: FACTS}), ("/t", LINK)]


def test_the_topics_of_an_action_that_is_served_here_never_cross_as_topics() -> None:
    """A client registers one topic after the other."""

    def handle(*_: Any) -> Any:
        return SimpleNamespace(close=lambda: None, send=lambda *_: None, forget=lambda *_: None, dropped=0)

    network = SimpleNamespace(
        own=lambda: "/midspan", facts=dict, registry=Registry(), clock=lambda: SYSTEM, hear=handle, tell=handle,
        refuse=handle, check_frames=False,
    )  # fmt: skip
    actions = Actions(network)  # type: ignore[arg-type]
    goal = "move_base_msgs/MoveBaseActionGoal"
    assert not actions.is_part("/go/goal", goal)
    types = {part: f"move_base_msgs/action/MoveBase_{name}" for part, name in NAMES.items()}
    served = [actions.serve("/go", part, types.get(part, "action_msgs/srv/CancelGoal"), handle) for part in SERVICES]
    try:
        assert actions.is_part("/go/goal", goal)
        assert actions.is_part("/go/cancel", "")
        assert not actions.is_part("/go/goal", "std_msgs/String")
        assert not actions.is_part("/other/goal", goal)
    finally:
        for part in served:
            part.close()
        actions.stop()
