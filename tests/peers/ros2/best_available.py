"""A real rclpy program like `tests.peers.ros2.peer`, whose endpoints have the QoS BEST_AVAILABLE."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from rclpy.qos import qos_profile_best_available

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.peers.ros2.peer import Peer, main


class BestAvailablePeer(Peer):
    """The program's commands; ``advertise`` and ``subscribe`` ignore the command's QoS."""

    def profile(self, _params: dict[str, Any]) -> Any:
        return qos_profile_best_available


if __name__ == "__main__":
    main(BestAvailablePeer)
