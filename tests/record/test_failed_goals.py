"""The ring is kept when a goal fails, as the real gateway reports it."""

from __future__ import annotations

from pathlib import Path

import pytest

from bridge.record import triggers
from bridge.record.places import PREFIX
from bridge.record.worker import RecordWorker
from navigation.status import State
from tests.peers.hub.recorded_robot import config, read
from tests.peers.navigation.gateway import ClientGoal, Rig, pose
from tests.support.wait import until


def test_each_rejected_or_aborted_goal_keeps_the_ring(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(triggers, "QUIET_SECONDS", 0.0)
    worker = RecordWorker()
    with Rig(tmp_path / "gateway") as rig:
        subscribers = len(rig.client.node.hub.graph.subscriptions("/navigation/status"))
        worker.start(config(rig.hubs, tmp_path, enabled=True, ring={"seconds": 30.0}))
        try:
            graph = rig.client.node.hub.graph
            until(
                lambda: len(graph.subscriptions("/navigation/status")) > subscribers,
                "the gateway's status is subscribed",
            )
            # the trigger may be subscribed before the recorder, and an empty ring is not kept
            recorder = lambda: rig.client.node.hub.ask("status", {}, worker="record")  # noqa: E731
            until(lambda: any(answer.value["recording"]["messages"] for answer in recorder()), "the ring has a message")

            def kept_reasons() -> list[str]:
                folders = sorted((tmp_path / "robot1" / "recordings").glob(f"{PREFIX}*/metadata.yaml"))
                return [
                    read(max(folder_.parent.glob("*.mcap"))).metadata["midspan.end"]["trigger"] for folder_ in folders
                ]

            # the planner has been available for a while, so a rejection counts
            rig.gateway.link.presence.unreachable_at = 0.0
            for count in (1, 2):
                rig.planner.rejects = 1
                status, reason = ClientGoal(rig.client, pose(1.0)).end()
                assert (status, reason) == ("ABORTED", "robot_goto rejected the goal")
                until(lambda n=count: len(kept_reasons()) == n, "the ring is written")  # type: ignore[misc]
            given = ClientGoal(rig.client, pose(2.0))
            rig.planner.give_up(rig.planner.until(1), "no way leads there")
            assert given.end()[0] == "ABORTED"
            until(lambda: len(kept_reasons()) == 3, "the ring is written")
            reached = ClientGoal(rig.client, pose(3.0))
            rig.planner.reach(rig.planner.until(2))
            assert reached.end()[0] == "SUCCEEDED"
            rig.state(State.REACHED)
            assert kept_reasons() == [
                f"a goal failed: {reason}",
                f"a goal failed: {reason}",
                "a goal failed: no way leads there",
            ]
        finally:
            worker.stop()
