"""Events (goals, changes of the store, elections) are counted, as scraped from real daemons."""

from __future__ import annotations

import math
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import psutil
import pytest
from prometheus_client.parser import text_string_to_metric_families as parse

from bridge.client.store import StoreClient
from bridge.stores.kinds import LOCATION
from bridge.stores.store import Write
from bridge.stores.wire import prefix
from tests.peers.daemon.midspan import MidspanDaemon
from tests.peers.hub.node import HubNode
from tests.peers.navigation.gateway import ClientGoal, Planner, pose
from tests.peers.yarp.programs import Names
from tests.support.ports import free_port
from tests.support.wait import until
from yarp_compat.dev.locations import Map2DLocation

OFF = {"enabled": False}


class MeteredDaemon(MidspanDaemon):
    """A daemon ``name`` with YARP and metrics only; its hub joins that of ``join``."""

    def __init__(
        self, folder: Path, name: str, names: Names, join: MeteredDaemon | None = None, **sections: Any
    ) -> None:
        (folder / name).mkdir()
        super().__init__(folder / name, name)
        self._metrics = free_port()
        links = {"connect": {"endpoints": [join.endpoint]}} if join else {}
        self.configure(
            state=str(self.folder), hub={"listen": self.endpoint, "router_zenoh": links}, ros1=OFF, ros2=OFF,
            yarp={"nameserver": "site", "address": names.endpoint, "poll": 0.1},
            metrics={"enabled": True, "listen": f"127.0.0.1:{self._metrics}"}, **sections,
        )  # fmt: skip
        self.process = self.midspan("run")

    def values(self, family: str, label: str) -> dict[str, float]:
        """Return a family's values by one of its labels; empty if it is not reported or the daemon does not answer."""
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{self._metrics}/metrics", timeout=20) as answer:
                families = parse(answer.read().decode())
        except OSError:
            return {}
        samples = [sample for known in families for sample in known.samples if sample.name == family]
        return {sample.labels.get(label, ""): sample.value for sample in samples}

    def value(self, family: str) -> float:
        """Return the value of a family with one sample; a busy worker may answer too late for some scrapes."""
        (value,) = until(lambda: self.values(family, ""), f"{family} is reported", 40, every=0.2).values()
        return value

    def until(self, family: str, label: str = "", **wanted: float) -> None:
        """Wait for values by a label; without a label, for ``value``."""
        want = wanted if label else {"": wanted["value"]}
        values: dict[str, float] = {}

        def matches() -> bool:
            values.clear()
            values.update(self.values(family, label))
            return want.items() <= values.items()

        try:
            until(matches, f"{family} is {want}", 40, every=0.2)
        except AssertionError as err:
            raise AssertionError(f"{err}: {values}; the daemon: {self.process.output()[-3000:]}") from None


@pytest.fixture
def names() -> Iterator[Names]:
    servers = Names()
    yield servers
    servers.stop()


def test_goals_and_changes_of_the_store_are_counted(tmp_path: Path, names: Names) -> None:
    planner = {"name": "mine", "side": "zenoh", "action": "/planner/mine/navigate_to_pose"}
    navigation = {"planner": "mine", "planners": [planner]}
    daemon = MeteredDaemon(tmp_path, "here", names, navigation=navigation, store={"enabled": True})
    with ExitStack() as stack:
        stack.enter_context(daemon.process)
        daemon.until("midspan_goals_total", "outcome", reached=0, failed=0, canceled=0, replaced=0, refused=0)
        mine, client = Planner(daemon.settings("mine"), "mine"), HubNode(daemon.settings("client"))
        stack.callback(mine.close)
        stack.callback(client.close)
        daemon.until("midspan_module_state", "state", running=1)

        reached = ClientGoal(client, pose(1.0))
        goal = mine.until(1)
        daemon.until("midspan_goal_active", value=1)
        mine.reach(goal)
        assert reached.end()[0] == "SUCCEEDED"
        canceled = ClientGoal(client, pose(2.0))
        mine.until(2)
        canceled.cancel()
        assert canceled.end()[0] == "CANCELED"
        assert ClientGoal(client, pose(math.nan)).end()[0] == "ABORTED"
        replaced = ClientGoal(client, pose(4.0))
        mine.until(3)
        last = ClientGoal(client, pose(5.0))
        assert replaced.end()[0] == "CANCELED"
        mine.give_up(mine.until(4), "no path to the goal")
        assert last.end()[0] == "ABORTED"
        daemon.until("midspan_goals_total", "outcome", reached=1, canceled=1, refused=1, failed=1, replaced=1)

        clicked = client.on(lambda: client.node.publisher("/goal_pose", "geometry_msgs/msg/PoseStamped"))
        until(lambda: client.node.hub.graph.subscriptions("/goal_pose"), "the gateway subscribes")
        clicked.publish(pose(math.nan))
        daemon.until("midspan_goals_total", "outcome", refused=2)
        mine.rejects = 1000  # a planner that has just joined is tried again
        clicked.publish(pose(6.0))
        daemon.until("midspan_goals_total", "outcome", failed=2)
        mine.rejects = 0
        clicked.publish(pose(7.0))
        mine.reach(mine.until(5))
        daemon.until("midspan_goals_total", "outcome", reached=2, canceled=1, refused=2, failed=2, replaced=1)
        daemon.until("midspan_goal_active", value=0)

        store = StoreClient(client.node.hub.keyspace(prefix(0)), "here")
        daemon.until("midspan_store_replicas", value=0)
        store.write([Write(LOCATION, name, Map2DLocation("hall", 1.0, 2.0, 0.0)) for name in ("dock", "door")])
        daemon.until("midspan_store_values", "kind", location=2)
        size, changed = daemon.value("midspan_store_bytes"), daemon.value("midspan_store_last_change_timestamp_seconds")
        assert size > 0
        store.write([Write(LOCATION, "dock", None)])
        daemon.until("midspan_store_values", "kind", location=1)
        daemon.until("midspan_store_deleted", value=1)
        assert daemon.value("midspan_store_bytes") == size / 2
        assert daemon.value("midspan_store_last_change_timestamp_seconds") > changed


@pytest.mark.thorough
def test_an_election_is_counted_by_winner_and_loser(tmp_path: Path, names: Names) -> None:
    with ExitStack() as stack:
        first = MeteredDaemon(tmp_path, "first", names)
        stack.enter_context(first.process)
        first.until("midspan_side_lease", "side", yarp=1)
        first.until("midspan_side_members", "side", yarp=1)
        second = MeteredDaemon(tmp_path, "second", names, first)
        stack.enter_context(second.process)
        for daemon_ in (first, second):
            daemon_.until("midspan_side_members", "side", yarp=2)
        second.until("midspan_side_state", "state", standby=1, running=0)
        changes = {daemon_: daemon_.value("midspan_side_lease_changes_total") for daemon_ in (first, second)}
        assert (changes, second.value("midspan_side_lease")) == ({first: 1, second: 0}, 0)
        daemon = psutil.Process(first.process.pid)
        processes = [daemon, *daemon.children(recursive=True)]
        for process in processes:
            process.suspend()
        try:
            second.until("midspan_side_lease_changes_total", "side", yarp=1)
            second.until("midspan_side_lease", "side", yarp=1)
        finally:
            for process in reversed(processes):
                process.resume()
        first.until("midspan_side_state", "state", standby=1)
        first.until("midspan_side_lease_changes_total", "side", yarp=2)
        assert first.value("midspan_side_lease") == 0
        assert second.value("midspan_side_lease_changes_total") == 1
