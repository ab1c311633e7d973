"""A chain of frames from ROS 1, ROS 2 and YARP, looked up from all three by programs that join late."""

from __future__ import annotations

import contextlib
import time
from typing import Any

import numpy as np

from bridge.tf.buffer import TransformBuffer
from bridge.tf.errors import TransformError
from bridge.tf.transform import Transform
from tests.peers.daemon.deployment import Deployment
from tests.peers.peer import Peer
from tests.support.ports import free_port
from tests.support.wait import until
from yarp_compat.dev import frametree
from yarp_compat.dev.frametransform_client import TransformClient
from yarp_compat.dev.frametree import of_angles
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address

TF = "tf2_msgs/TFMessage"
MOUNT = of_angles(0.1, 0.2, 0.3)
MOUNT[:3, 3] = 0.5, 0.25, 1.0


class Speaker:
    """A ROS program that publishes a moving frame, and a static frame mounted on it."""

    def __init__(self, peer: Peer, words: tuple[str, str], parent: str, child: str, mounted: str, x: float) -> None:
        self.peer, self.words, self.parent, self.child, self.x = peer, words, parent, child, x
        self.tf, self.tf_static = peer.advertise("/tf", TF), peer.advertise("/tf_static", TF, latched=True, depth=1)
        peer.publish(self.tf_static, {"transforms": [stamped(words, child, mounted, 1.0)]})

    def publish(self) -> None:
        self.peer.publish(self.tf, {"transforms": [stamped(self.words, self.parent, self.child, self.x)]})


class Listener:
    """The frames that a ROS program receives."""

    def __init__(self, peer: Peer) -> None:
        self.peer, self.buffer, self.taken = peer, TransformBuffer(), [0, 0]
        self.received = peer.subscribe("/tf", TF, depth=1000), peer.subscribe("/tf_static", TF, latched=True, depth=100)

    def lookup(self, target: str, source: str) -> Transform | None:
        for n, subscription in enumerate(self.received):
            messages = self.peer.wait(subscription, 0, 0.0)
            for message in messages[self.taken[n] :]:
                for transform in message["transforms"]:
                    header, pose = transform["header"], transform["transform"]
                    seconds, nanoseconds = (part for part in header["stamp"].values())
                    moved, turned = ([float(pose[k][i]) for i in axes] for k, axes in PARTS)
                    self.buffer.set_transform(
                        header["frame_id"],
                        transform["child_frame_id"],
                        seconds * 10**9 + nanoseconds,
                        moved,
                        turned,
                        static=n == 1,
                    )
            self.taken[n] = len(messages)
        try:
            return self.buffer.lookup_transform(target, source)
        except TransformError:
            return None


PARTS = (("translation", "xyz"), ("rotation", "xyzw"))


def stamped(words: tuple[str, str], parent: str, child: str, x: float) -> dict[str, Any]:
    """Return a frame at distance ``x`` ahead, turned by 90 degrees to the left."""
    stamp = dict(zip(words, divmod(time.time_ns(), 10**9), strict=True))
    half = 0.5**0.5
    pose = {"translation": {"x": x, "y": 0.0, "z": 0.0}, "rotation": {"x": 0.0, "y": 0.0, "z": half, "w": half}}
    return {"header": {"stamp": stamp, "frame_id": parent}, "child_frame_id": child, "transform": pose}


def test_a_chain_of_frames_from_three_sides_is_the_same_on_all(deployment: Deployment) -> None:
    number = free_port()
    deployment.start(
        yarp={"address": f"127.0.0.1:{number}", "nameserver": "embedded", "poll": 0.1},
        modules={"transform_server": {"enabled": True}},
    )
    names = NameClient(Address("127.0.0.1", number))
    ports = "/frameTransformServer/frameTransformGet_nws_yarp/tf:o"
    until(lambda: named(names, ports), "the server's ports exist", 40, 0.2)
    speakers = (
        Speaker(deployment.ros1(), ("secs", "nsecs"), "map", "odom", "beacon", 2.0),
        Speaker(deployment.ros2(), ("sec", "nanosec"), "odom", "base", "bumper", 3.0),
    )
    with TransformClient(naming=names) as yarp:
        yarp.set("lens", "laser", MOUNT, static=True)

        def publish() -> None:
            for speaker in speakers:
                speaker.publish()
            yarp.set("laser", "base", MOUNT)

        late = Listener(deployment.ros1()), Listener(deployment.ros2())
        with TransformClient(naming=names) as late_yarp:
            want = chain(2.0) @ chain(3.0) @ MOUNT @ MOUNT
            for listener in late:
                result = until(
                    lambda one=listener: (publish(), one.lookup("map", "lens"))[1], "ROS has the chain", 60, 0.1
                )
                np.testing.assert_allclose(result.translation, want[:3, 3], atol=1e-9)
                until(
                    lambda one=listener: all(one.lookup("map", n) for n in ("beacon", "bumper")),
                    "ROS has all mounted frames",
                    60,
                    0.1,
                )
            for client in (yarp, late_yarp):
                (pose,) = until(lambda c=client: (publish(), posed(c))[1], "YARP has the chain", 60, 0.1)
                np.testing.assert_allclose(pose, want, atol=1e-9)
                until(lambda c=client: {"beacon", "bumper"} <= set(c), "YARP has all mounted frames", 60, 0.1)


def posed(client: TransformClient) -> list[np.ndarray]:
    """Return the pose in a list, which is empty while a frame is missing; moving frames expire soon."""
    if client.canTransform("lens", "map"):
        with contextlib.suppress(frametree.TransformError):
            return [client.pose("lens", "map", timeout=1.0)]
    return []


def chain(x: float) -> np.ndarray:
    created = of_angles(0.0, 0.0, np.pi / 2)
    created[0, 3] = x
    return created


def named(names: NameClient, port: str) -> bool:
    try:
        return names.query(port) is not None
    except OSError:
        return False
