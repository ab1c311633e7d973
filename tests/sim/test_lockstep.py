"""In lock-step with a module on the hub: the same commands at the same times, and so the same run."""

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
    """Turns the wheels by what their encoders said last, fifty times a second of its clock."""

    name = "driver"

    def start(self, host: Host, section: Any) -> None:  # noqa: ARG002
        out = host.node.publisher("/wheel_command", "sensor_msgs/msg/JointState", Qos(depth=1), priority="command")
        turned = [0.0, 0.0]

        def heard(message: dict[str, Any]) -> None:
            turned[:] = message["position"]

        def drive() -> None:
            velocities = [1.0 + turned[1] % 0.7, 1.5 - turned[0] % 0.3]
            out.publish({"header": {"stamp": host.clock.stamp()}, "name": WHEELS, "velocity": velocities})

        host.node.subscription("/joint_states", "sensor_msgs/msg/JointState", heard)
        host.every(0.02, drive)


def test_the_same_run_bit_for_bit_with_a_module_on_the_hub(tmp_path: Path) -> None:
    place, modules = Place(tmp_path), ModulesWorker()
    try:
        own = {"name": "driver", "factory": "tests.sim.test_lockstep:Driver"}
        sim = {"plan": "hall", "drive": "wheels", "speed": "step", "encoders": {"noise": 0.01}, "seed": 5}
        config = place.config(**sim).model_dump() | {"clock": {"source": "sim"}, "modules": {"own": [own]}}
        config = type(place.config()).model_validate(config)
        truth = place.far.subscribe("/ground_truth", "nav_msgs/Odometry", depth=1000)
        place.worker.start(config)
        modules.start(config)
        until(lambda: (place.step(0.02), place.status()["truth"][0] > 0.01)[1], "the driver drives", 30)

        def heard() -> list[dict[str, Any]]:
            return place.far.wait(truth, 1)

        def run() -> list[tuple[float, float]]:
            """Where the base came to in 25 steps after a reset, tick by tick of the topic."""
            assert place.call("/sim/reset", "std_srvs/Trigger")["success"]
            stamps = []
            for _ in range(25):
                reply = place.step(0.02, "driver")
                assert reply["success"], reply
                stamps.append(tuple(reply["stamp"].values()))

            def poses() -> list[tuple[float, float]]:
                told = {tuple(m["header"]["stamp"].values()): m["pose"]["pose"]["position"] for m in heard()}
                return [(told[stamp]["x"], told[stamp]["y"]) for stamp in stamps if stamp in told]

            until(lambda: len(poses()) == 25, "all of them are told")
            return poses()

        run()  # the first begins with whatever the driver heard last
        first = run()
        assert first[-1][0] > 0.05
        assert run() == first
    finally:
        modules.stop()
        place.close()
