"""Facts about publishers and servers are passed on in the order of discovery."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any, cast

from bridge.adapters.ros1.actions.actions import Ros1Actions
from bridge.adapters.ros1.actions.network import ActionNetwork
from bridge.adapters.ros1.graph.probe import EndUpdater, Facts
from bridge.adapters.ros1.graph.state import Registration
from bridge.clock import SYSTEM
from bridge.messages.actions import SERVICES
from bridge.messages.registry import Registry

NAMES = {"send_goal": "SendGoal", "get_result": "GetResult"}
LINK, FACTS = Registration("/a", "/t", "http://a:1/"), Facts("m/T", "1", "", latching=False, native=True)
HEADER = {"type": FACTS.type, "md5sum": FACTS.md5}


class LateProber:
    """Returns outdated facts to its first caller, and only after another caller has passed on newer facts."""

    def __init__(self, follow: Callable[[], None]) -> None:
        self._follow, self._asked = follow, 0

    def facts(self, _topic: str = "") -> Mapping[Registration, Facts]:
        self._asked += 1
        if self._asked > 1:
            return {LINK: FACTS}
        self.other = threading.Thread(target=self._follow)
        self.other.start()
        self.other.join(0.2)  # do not wait for a caller that itself waits for the first one
        return {}

    def close(self) -> None:
        """Do nothing."""


class End:
    """A subscription or a caller."""

    needs_connection = False

    def __init__(self, name: str) -> None:
        self.name = name

    def close(self) -> None:
        """Do nothing."""


class RecordingUpdater(EndUpdater[End]):
    """Passes all known facts to its ends."""

    def __init__(self, jobs: list[Callable[[], object]]) -> None:
        pool = SimpleNamespace(submit=lambda _uri, job: jobs.append(job), answered=lambda _uri: None)
        context: Any = SimpleNamespace(pool=pool, node=lambda: "/me", timer=None, facts_changed=lambda: None)
        super().__init__(context, lambda *_: (cast("Any", SimpleNamespace(close=lambda: None)), HEADER))
        self.informed: list[tuple[str, Mapping[Registration, Facts]]] = []

    def add(self, *names: str) -> None:
        for name in names:
            self._add(End(name))

    def _notify(self, end: End, known: Mapping[Registration, Facts]) -> None:
        self.informed.append((end.name, known))


def test_older_facts_are_not_passed_on_after_newer_ones() -> None:
    updater = RecordingUpdater([])
    updater.prober = late = LateProber(updater.inform)  # type: ignore[assignment]
    updater.add("/t")
    late.other.join()
    assert updater.informed == [("/t", {}), ("/t", {LINK: FACTS})]


def test_facts_about_one_topic_are_not_passed_to_others() -> None:
    """Otherwise, with a thousand topics, each of a thousand responses would update a thousand subscriptions."""
    jobs: list[Callable[[], object]] = []
    updater = RecordingUpdater(jobs)
    updater.add("/t", "/u")
    updater.update(frozenset({LINK, Registration("/b", "/u", "http://b:1/")}))
    for job in jobs:
        updater.informed.clear()
        job()
        ((name, known),) = updater.informed
        assert {link.topic: facts for link, facts in known.items()} == {name: FACTS}


def test_the_topics_of_an_action_that_is_served_here_never_cross_as_topics() -> None:
    """A client registers its topics one after the other."""

    def handle(*_: Any) -> Any:
        return SimpleNamespace(close=lambda: None, send=lambda *_: None, dropped=0)

    network = ActionNetwork(
        own=lambda: "/midspan", facts=dict, registry=Registry(), clock=lambda: SYSTEM, subscribe=handle, publish=handle,
        refuse=handle, check_frames=False,
    )  # fmt: skip
    actions = Ros1Actions(network)
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
