"""Runs in lock-step with a module on the hub are reproducible."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bridge.hub.wire.qos import Qos
from bridge.modules.host import Host
from bridge.modules.module import Module
from bridge.modules.worker import ModulesWorker
from tests.sim.test_hub import WHEELS, Place
from tests.support.wait import until


class Driver(Module):
    """Turns the wheels depending on their last encoder reading, 50 times per simulated second."""

    name = "driver"

    def start(self, host: Host, section: Any) -> None:  # noqa: ARG002
        out = host.node.publisher("/wheel_command", "sensor_msgs/msg/JointState", Qos(depth=1), priority="command")
        turned = [0.0, 0.0]

        def on_joint_states(message: dict[str, Any]) -> None:
            turned[:] = message["position"]

        def drive() -> None:
            velocities = [1.0 + turned[1] % 0.7, 1.5 - turned[0] % 0.3]
            out.publish({"header": {"stamp": host.clock.stamp()}, "name": WHEELS, "velocity": velocities})

        host.node.subscription("/joint_states", "sensor_msgs/msg/JointState", on_joint_states)
        host.every(0.02, drive)


def test_runs_with_a_module_on_the_hub_are_identical(tmp_path: Path) -> None:
    place, modules = Place(tmp_path), ModulesWorker()
    try:
        driver = {"name": "driver", "factory": "tests.sim.test_lockstep:Driver"}
        sim = {"plan": "hall", "drive": "wheels", "speed": "step", "encoders": {"noise": 0.01}, "seed": 5}
        config = place.config(**sim).model_dump() | {"clock": {"source": "sim"}, "modules": {"own": [driver]}}
        config = type(place.config()).model_validate(config)
        truth = place.far.subscribe("/ground_truth", "nav_msgs/Odometry", depth=1000)
        place.worker.start(config)
        modules.start(config)
        until(lambda: (place.step(0.02), place.answer("sim")["truth"][0] > 0.01)[1], "the driver drives", 30)

        def truths() -> list[dict[str, Any]]:
            return place.far.wait(truth, 1)

        def run() -> list[tuple[float, float]]:
            """Return the base's positions at 25 steps after a reset, as published on the topic."""
            assert place.call("/sim/reset", "std_srvs/Trigger")["success"]
            stamps = []
            for _ in range(25):
                reply = place.step(0.02, "driver")
                assert reply["success"], reply
                stamps.append(tuple(reply["stamp"].values()))

            def poses() -> list[tuple[float, float]]:
                positions = {tuple(m["header"]["stamp"].values()): m["pose"]["pose"]["position"] for m in truths()}
                return [(positions[stamp]["x"], positions[stamp]["y"]) for stamp in stamps if stamp in positions]

            until(lambda: len(poses()) == 25, "all poses arrive")
            return poses()

        run()  # not compared, because the first run begins with an encoder reading from before the reset
        first = run()
        assert first[-1][0] > 0.05
        assert run() == first
    finally:
        modules.stop()
        place.close()
