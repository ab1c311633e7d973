"""A participant whose shared-memory port was replaced while it was suspended receives nothing, and restarts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from bridge.adapters.ros2.graph import ports
from bridge.hub.shared_memory import FOLDER
from bridge.messages.registry import Registry
from tests.adapters.ros2.conftest import RunningEdge
from tests.peers.peer import Peer
from tests.support.wait import until

TOPIC, TYPE = "/lost_port", "std_msgs/msg/String"


def test_an_edge_without_its_port_restarts(registry: Registry, tmp_path: Path, peer: Callable[..., Peer]) -> None:
    running = RunningEdge(registry, tmp_path)
    try:
        inbox, program = running.subscribe(TOPIC, TYPE), peer()
        end = program.advertise(TOPIC, TYPE.replace("/msg", ""))

        def received() -> bool:
            program.publish(end, {"data": "before"})
            return "before" in inbox.texts()

        until(received, "messages arrive over shared memory")
        own = ports.locked_ports(Path("/proc/self"))
        assert own, "the edge listens at a port"
        assert not ports.lost_ports()
        assert not running.failures
        for name in own:
            (FOLDER / name).unlink()
        running.edge.resumed(2.0)
        (reason, *_) = until(lambda: running.failures, "the edge requests a restart")
        assert "removed this participant's shared memory" in reason
    finally:
        running.edge.stop()
