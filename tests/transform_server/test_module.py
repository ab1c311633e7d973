"""The transform server in its host: on a hub, with a name server and clients over real ports."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge.config.model import Config
from tests.modules.test_worker import Place
from tests.support.wait import until
from yarp_compat.dev.frametransform_client import TransformClient
from yarp_compat.dev.frametree import TransformError, transform_of
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.naming.server import NameServer

TF = "tf2_msgs/TFMessage"
LASER = np.eye(4)
LASER[0, 3] = 0.5


class ServedPlace(Place):
    """The module, with its clients and a node of the hub."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.server = NameServer(port=self.port, gc_seconds=0)
        self.server.__enter__()
        self.timed, self.static = self.far.advertise("/tf", TF), self.far.advertise("/tf_static", TF, latched=True)
        self.received, self.static_frames = (
            self.far.subscribe("/tf", TF),
            self.far.subscribe("/tf_static", TF, latched=True),
        )
        self.worker.start(self.served())

    def served(self, clock: dict[str, Any] | None = None, **options: Any) -> Config:
        return self.config(clock=clock or {}, modules={"transform_server": {"enabled": True, **options}})

    def client(self, **options: Any) -> TransformClient:
        return TransformClient(naming=NameClient(Address("127.0.0.1", self.port), namespace="/root"), **options)

    def to_open(self, **options: Any) -> TransformClient:
        """Open a client once the server's ports are registered."""
        for kind in (
            "frameTransformSet_nws_yarp/thrift",
            "frameTransformGet_nws_yarp/thrift",
            "frameTransformGet_nws_yarp/tf:o",
        ):
            name = f"{options.get('server', '')}/frameTransformServer/{kind}"
            until(lambda n=name: connections.exists(self.names, n), f"{name} is registered")
        return self.client(**options)

    def publish(self, parent: str, child: str, *, static: bool = False, stamp: float | None = None) -> None:
        """Publish a frame on the hub."""
        sec, nanosec = divmod(round((stamp or time.time()) * 1e9), 1_000_000_000)
        header = {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": parent}
        pose = {"translation": {"x": 1.0, "y": 0.0, "z": 0.0}, "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
        transform = {"header": header, "child_frame_id": child, "transform": pose}
        self.far.publish(self.static if static else self.timed, {"transforms": [transform]})

    def transforms(self, heard: int) -> list[dict[str, Any]]:
        """Return the transforms that a subscription of the hub has received."""
        return [t for m in self.far.wait(heard, 0, 0.05) for t in m["transforms"]]

    def children(self, heard: int) -> list[str]:
        """Return the child frames of the transforms that a subscription of the hub has received."""
        return [t["child_frame_id"] for t in self.transforms(heard)]

    def close(self) -> None:
        super().close()
        self.server.__exit__(None, None, None)


@pytest.fixture
def place(tmp_path: Path) -> Iterator[ServedPlace]:
    with ServedPlace(tmp_path) as opened:
        yield opened


def test_a_client_and_the_hub_receive_each_others_frames(place: ServedPlace) -> None:
    place.publish("base", "gripper", static=True)
    with place.to_open() as frames, place.to_open(streaming=False) as asking:

        def both_received() -> bool:
            place.publish("map", "base")
            frames.set("arm", "base", LASER)
            return "arm" in place.children(place.received) and "gripper" in frames and "arm" in frames

        until(both_received, "both sides have received all frames")
        frames.set("laser", "base", LASER, static=True)
        until(lambda: "laser" in place.children(place.static_frames), "the static frame is published")
        for client in (frames, asking):
            point = until(
                lambda c=client: (place.publish("map", "base"), laser_point(c))[1], "the client has the frames"
            )
            assert point == [1.5, 2.0, 0.0]
        assert "gripper" not in place.children(place.static_frames), "the hub's frames are not published again"
        frames.delete("laser", "base")
        until(lambda: "laser" not in frames and "laser" not in asking, "the frame is deleted")
        assert frames.waitForTransform("gripper", "base", 20.0)
        assert set(place.children(place.received)) == {"arm"}
    place.publish("elsewhere", "base")
    children = {"frame": "base", "parents": ["elsewhere", "map"], "sources": ["/far"]}
    until(lambda: (place.status("transform_server") or {}).get("conflicts") == [children], "both parents are reported")
    assert place.answer("transform_server")["refused"] == {}


def laser_point(client: TransformClient) -> list[float] | None:
    """Return a point seen by the laser, in the map frame."""
    try:
        return client.points([0.0, 2.0, 0.0], "laser", "map").tolist()
    except TransformError:
        return None


def test_frames_expire_in_simulated_time(place: ServedPlace) -> None:
    place.worker.stop()
    place.worker.start(place.served(clock={"source": "sim"}))
    clock = place.far.advertise("/clock", "rosgraph_msgs/Clock")

    def tick(seconds: int) -> None:
        place.far.publish(clock, {"clock": {"sec": seconds, "nanosec": 0}})

    with place.to_open() as frames:

        def both() -> bool:
            tick(100)
            place.publish("map", "base", stamp=100)
            frames.setTransform("arm", "base", LASER)  # stamped by the system's clock; refused until there is a time
            return {"base", "arm"} <= set(frames)

        def stamp() -> float | None:
            both()  # a client drops frames that are not repeated
            return {t.dst_frame_id: t.timestamp for t in frames.tree().transforms}.get("base")

        until(both, "the client has both frames")
        assert until(stamp, "a stamp is received") == 100.0
        arm = until(
            lambda: (both(), [t for t in place.transforms(place.received) if t["child_frame_id"] == "arm"])[1], "", 20
        )
        assert 99 <= arm[0]["header"]["stamp"]["sec"] <= 100
        tick(100)
        place.publish("base", "camera", static=True)
        until(lambda: (both(), "camera" in frames)[1], "the static frame is shown")
        until(lambda: (tick(1), set(frames) == {"base", "camera"})[1], "the other frames are dropped")


def test_lifetimes_change_at_run_time_and_the_prefix_with_a_restart(place: ServedPlace) -> None:
    with place.to_open() as frames:
        before = place.answer("transform_server")
        assert place.worker.reload(place.served(yarp_frame_lifetime=600.0))
        assert frames.send([transform_of("base", "map", LASER, time.time() - 60.0)])
        until(lambda: "base" in frames, "the frame is shown although it is old")
        after = place.answer("transform_server")
        assert after["zid"] == before["zid"], "the configuration is applied without a restart"
    assert place.worker.reload(place.served(prefix="/robot"))
    with place.to_open(server="/robot", name="/gui") as frames:
        assert place.names.query("/gui/frameTransformClient/frameTransformGet_nwc_yarp/tf:i")
        assert not frames.waitForTransform("base", "map", 0.1), "the server was restarted, so the frame is gone"


def test_a_client_reconnects_to_a_restarted_server(place: ServedPlace) -> None:
    with place.to_open() as frames:
        frames.set("laser", "base", LASER, static=True)
        assert frames.waitForTransform("laser", "base", 20.0)
        place.worker.stop()
        assert not frames.setTransform("arm", "base", LASER)
        place.worker.start(place.served())

        def set_again() -> bool:
            return bool(frames.setTransformStatic("camera", "base", LASER)) or "camera" in frames

        until(set_again, "the client sets frames again", 30)
        assert frames.waitForTransform("camera", "base", 20.0)
        assert "laser" not in frames, "a server starts without frames"
