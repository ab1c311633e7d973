"""``python -m tests.examples``: "go to a location" from each framework, with planners of each framework.

The planners are stand-ins, the middlewares are real. `tests.examples.test_examples` uses only the first planner.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from tests.peers.daemon.deployment import Deployment
from tests.peers.daemon.examples import PLANNER, Examples, run
from tests.peers.ros1.network import ROS1_PYTHON
from tests.peers.ros2.network import ros2_environment, ros2_python
from tests.support.process import Process
from tests.support.wait import until

PEERS = Path(__file__).parents[1] / "peers"
SIDES = ("yarp", "rospy", "rclpy", "zenoh")


def start(place: Examples, planner: str) -> Process | None:
    """Start a planner, and select it in the gateway."""
    deployment = place.deployment
    program = None
    if planner == "move_base":
        program = Process([ROS1_PYTHON, PEERS / "ros1" / "move_base.py", "2.0", "0.5"], deployment.master.env)
    elif planner == "nav2":
        program = Process([ros2_python(), PEERS / "ros2" / "nav2.py", "2.0", "0.5"], ros2_environment())
    deployment.configure(**place.sections(planner))
    deployment.hang_up()

    def chosen() -> bool:
        gateways = [status for status in deployment.status() if status.get("worker") == "gateway"]
        return bool(gateways) and (gateways[0]["planner"], gateways[0]["state"]) == (planner, "running")

    until(chosen, f"{planner} is the planner", 40, 0.1)
    return program


def main() -> int:
    """Print each client's last line for each planner; return 1 if a goal was not reached."""
    failed = 0
    with tempfile.TemporaryDirectory() as folder, Deployment(Path(folder)) as deployment:
        place = Examples(deployment)
        for planner in (PLANNER, "move_base", "nav2"):
            program = start(place, planner)
            for side in SIDES:
                arguments = (f"tcp/127.0.0.1:{deployment.port}",) if side == "zenoh" else ()
                for name in ("hall", "kitchen"):
                    code, lines = run(place.start(side, f"goto_location_{side}.py", name, *arguments))
                    failed += code != 0
                    print(f"{planner:<20} {side:<6} {name:<8} {code}  {lines[-1] if lines else ''}", flush=True)
            if program is not None:
                program.stop()
        place.stop()
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
