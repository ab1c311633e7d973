"""A client of a server of transforms, as `frameTransformClient` is one, and the Python way.

with TransformClient() as frames:
    frames.set("camera", "base", pose, static=True)     # pose: a matrix of 4 by 4
    pose = frames.pose("camera", "map")                 # where the camera is on the map
    points = frames.points(points, "camera", "map")     # (N, 3), seen by the camera, on the map
    frames.getTransform("camera", "map", matrix)        # as in C++: true where it succeeded
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Self, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from yarp_compat.dev import frametransform as tf
from yarp_compat.dev.client import ClientOptions, ServiceClient
from yarp_compat.dev.frametransform import CLIENT, GET, SERVER, SET, STREAM, FrameTransform
from yarp_compat.dev.frametree import FrameTree, Pose, TransformError, transform_of
from yarp_compat.dev.iframetransform import IFrameTransform
from yarp_compat.dev.returnvalue import CallFailed, ReturnValue
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.os.time import now
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import PortError
from yarp_compat.ports.port import PortCore
from yarp_compat.ports.sockets import Openable, closed_on_failure
from yarp_compat.wire.elements import ElementReader
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.generation import Generation

LIFETIME = 0.2  # seconds after which what was received is too old, but for static transforms
_AGAIN = 0.5  # seconds between two attempts to have the server stream again
_POLL = 0.01  # seconds between two questions where the server does not stream


class TransformClient(Openable, IFrameTransform):
    """Frames of a server, between ``with`` and its end.

    The server streams all that it has; the client takes that apart when somebody asks. What came longer ago than
    `LIFETIME` is no longer known, by this machine's clock alone. Unless it is ``streaming``, the server is asked
    whenever somebody asks here. ``server`` begins the names of its ports (``/robot`` for
    ``/robot/frameTransformServer/...``), ``name`` those of the own ones, empty lets the name server choose them;
    options as of `ClientOptions`.
    """

    def __init__(
        self, server: str = "", name: str = "", *, streaming: bool = True, **options: Unpack[ClientOptions]
    ) -> None:
        self._naming = options["naming"] = options.get("naming") or NameClient()
        own = name and name + CLIENT
        self._setter = ServiceClient(tf.FrameTransformStorageSetRPC, server + SERVER + SET, _of(own, SET), **options)
        self._getter = ServiceClient(tf.FrameTransformStorageGetRPC, server + SERVER + GET, _of(own, GET), **options)
        self._streamed = server + SERVER + STREAM
        self._input = (
            PortCore(_of(own, STREAM).replace(":o", ":i"), on_message=self._take, naming=self._naming, is_output=False)
            if streaming
            else None
        )
        self._came = threading.Condition()
        self._newest: tuple[float, Buffer] | None = None
        self._tree = FrameTree()
        self._tree_of: float | None = None
        self._again = 0.0

    def open(self) -> Self:
        """Open the ports, unless they are, and connect them; errors as of `ServiceClient.open`."""
        with closed_on_failure(self):
            self._setter.open()
            self._getter.open()
            if self._input is not None:
                self._fetched()  # whose reply tells the server's release, before it streams
                if not self._input.is_open:
                    self._input.open()
                connections.connect(self._naming, self._streamed, self._input.name)
        return self

    def close(self) -> None:
        """Close the ports."""
        if self._input is not None:
            self._input.close()
        self._getter.close()
        self._setter.close()

    def pose(self, child: str, parent: str, *, timeout: float = 0.0) -> Pose:
        """A frame's pose (4, 4) in any other, within ``timeout`` seconds; raises `TransformError` if unknown."""
        deadline = time.monotonic() + timeout
        while True:
            try:
                return self.tree().pose(child, parent)
            except TransformError:
                if time.monotonic() >= deadline:
                    raise
            self._await(deadline)

    def points(self, points: ArrayLike, child: str, parent: str) -> NDArray[np.float64]:
        """Points (N, 3) or (3) that one frame sees, as another does. Errors as `pose`."""
        pose = self.pose(child, parent)
        moved: NDArray[np.float64] = np.asarray(points, float) @ pose[:3, :3].T + pose[:3, 3]
        return moved

    def set(self, child: str, parent: str, pose: ArrayLike, *, static: bool = False) -> None:
        """Set a frame's pose (4, 4) in its parent, now or for ever; raises `CallFailed`, `ValueError` for a shape."""
        self.set_all({(child, parent): pose}, static=static)

    def set_all(self, poses: Mapping[tuple[str, str], ArrayLike], *, static: bool = False) -> None:
        """Set the poses of many frames, in one call; by frame and parent. Errors as `set`."""
        stamp = now()
        _succeeded(self.send([transform_of(*names, pose, stamp, static=static) for names, pose in poses.items()]))

    def delete(self, child: str, parent: str) -> None:
        """Delete what was set between two frames (``*``: any); raises `CallFailed` where nothing is between them."""
        _succeeded(self.forget(child, parent))

    def __contains__(self, name: object) -> bool:
        return name in self.tree()

    def __iter__(self) -> Iterator[str]:
        return iter(self.tree().names())

    def tree(self) -> FrameTree:
        """All frames as they are known now; of a server that is asked raises `OSError`, `CallFailed` where it fails."""
        if self._input is None:
            return FrameTree(self._fetched())
        if not self._input.connections.inputs:
            self._connect_again()
        with self._came:
            newest = self._newest
            if newest is None:
                return self._tree
            came, payload = newest
            if self._tree_of != came:
                self._tree, self._tree_of = FrameTree(self._parsed(payload)), came
            if time.monotonic() - came > LIFETIME and any(not t.isStatic for t in self._tree.transforms):
                self._tree = FrameTree(t for t in self._tree.transforms if t.isStatic)
            return self._tree

    def send(self, transforms: list[FrameTransform]) -> ReturnValue:
        """Set transforms in one call: `IFrameTransformStorageSet::setTransforms`."""
        remote = self._setter.remote
        return remote.setTransformRPC(transforms[0]) if len(transforms) == 1 else remote.setTransformsRPC(transforms)

    def forget(self, one: str, other: str) -> ReturnValue:
        """Delete what is between two frames."""
        return self._setter.remote.deleteTransformRPC(one, other)

    def forget_all(self) -> ReturnValue:
        """Delete all transforms."""
        return self._setter.remote.clearAllRPC()

    def wait_until(self, known: Callable[[FrameTree], bool], timeout: float) -> bool:
        """Wait until something holds of the frames; whether it does in time."""
        deadline = time.monotonic() + timeout
        while not known(self.tree()):
            if time.monotonic() >= deadline:
                return False
            self._await(deadline)
        return True

    def _await(self, deadline: float) -> None:
        """Wait until it is worth to look again."""
        left = max(deadline - time.monotonic(), 0.0)
        with self._came:
            self._came.wait(min(left, _POLL if self._input is None else _AGAIN))

    def _fetched(self) -> list[FrameTransform]:
        outcome, transforms = self._getter.remote.getTransformsRPC()
        _succeeded(outcome)
        return transforms

    def _take(self, message: PortMessage) -> None:
        """Keep what was streamed, on its connection's thread."""
        with self._came:
            self._newest = time.monotonic(), message.payload
            self._came.notify_all()

    def _parsed(self, payload: Buffer) -> list[FrameTransform]:
        """Reads a streamed message, in the release that the server's replies told."""
        generation = self._getter.generation
        if generation is not Generation.YARP_3_11:
            return tf.AllTransforms.from_bytes(payload).transforms_list
        source, found = ElementReader(payload, generation.profile, generation), tf.AllTransforms()
        found._read(source)
        source.finish()
        return found.transforms_list

    def _connect_again(self) -> None:
        """Have a server stream that was away."""
        if self._input is None or time.monotonic() < self._again:
            return
        self._again = time.monotonic() + _AGAIN
        try:
            connections.connect(self._naming, self._streamed, self._input.name)
        except (PortError, OSError):
            return


def _of(own: str, part: str) -> str:
    return own and own + part.replace("_nws_", "_nwc_")


def _succeeded(outcome: ReturnValue) -> None:
    if not outcome:
        raise CallFailed(outcome.code, "the server of transforms refused; its log says why")


__all__ = ["TransformClient", "TransformError"]
