"""A client of a transform server, with the methods of `frameTransformClient` and a Python interface.

with TransformClient() as frames:
    frames.set("camera", "base", pose, static=True)     # pose: a 4 by 4 matrix
    pose = frames.pose("camera", "map")                 # the camera's pose on the map
    points = frames.points(points, "camera", "map")     # (N, 3), from the camera's frame to the map's
    frames.getTransform("camera", "map", matrix)        # as in C++: true if it succeeded
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
from yarp_compat.overriding import override
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import PortError
from yarp_compat.ports.port import PortCore
from yarp_compat.ports.sockets import Openable, closed_on_failure
from yarp_compat.wire.elements import ElementReader
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.generation import Generation

LIFETIME = 0.2  # seconds after which received transforms expire, except static ones
_RECONNECT_INTERVAL = 0.5  # seconds between attempts to reconnect the server's stream
_POLL = 0.01  # seconds between requests without a stream


class TransformClient(Openable, IFrameTransform):
    """The frames of a server, inside a ``with`` block.

    The server streams all its transforms; the client decodes a message at the next query. Transforms that are not
    static expire `LIFETIME` after their arrival; only this machine's clock counts. Without ``streaming``, each query
    sends a request to the server.

    ``server`` is the prefix of the server's ports (``/robot`` for ``/robot/frameTransformServer/...``), ``name`` that
    of the client's ports; if ``name`` is empty, the name server chooses their names. Options: see `ClientOptions`.
    """

    def __init__(
        self, server: str = "", name: str = "", *, streaming: bool = True, **options: Unpack[ClientOptions]
    ) -> None:
        self._naming = options["naming"] = options.get("naming") or NameClient()
        prefix = name and name + CLIENT
        source = server + SERVER
        self._setter = ServiceClient(tf.FrameTransformStorageSetRPC, source + SET, _port(prefix, SET), **options)
        self._getter = ServiceClient(tf.FrameTransformStorageGetRPC, source + GET, _port(prefix, GET), **options)
        self._streamed = source + STREAM
        stream_port = _port(prefix, STREAM).replace(":o", ":i")
        self._input = (
            PortCore(stream_port, on_message=self._on_message, naming=self._naming, is_output=False)
            if streaming
            else None
        )
        self._arrival = threading.Condition()
        self._newest: tuple[float, Buffer] | None = None
        self._tree = FrameTree()
        self._tree_of: float | None = None
        self._retry_at = 0.0

    @override
    def open(self) -> Self:
        with closed_on_failure(self):
            self._setter.open()
            self._getter.open()
            if self._input is not None:
                self._fetch()  # the reply shows the server's release, before it streams
                if not self._input.is_open:
                    self._input.open()
                connections.connect(self._naming, self._streamed, self._input.name)
        return self

    @override
    def close(self) -> None:
        if self._input is not None:
            self._input.close()
        self._getter.close()
        self._setter.close()

    def pose(self, child: str, parent: str, *, timeout: float = 0.0) -> Pose:
        """Return a frame's pose (4, 4) in another; raises `TransformError` if unknown after ``timeout`` seconds."""
        deadline = time.monotonic() + timeout
        while True:
            try:
                return self.tree().pose(child, parent)
            except TransformError:
                if time.monotonic() >= deadline:
                    raise
            self._await(deadline)

    def points(self, points: ArrayLike, child: str, parent: str) -> NDArray[np.float64]:
        """Transform points (N, 3) or (3) from one frame to another. Raises like `pose`."""
        pose = self.pose(child, parent)
        moved: NDArray[np.float64] = np.asarray(points, float) @ pose[:3, :3].T + pose[:3, 3]
        return moved

    def set(self, child: str, parent: str, pose: ArrayLike, *, static: bool = False) -> None:
        """Set a frame's pose (4, 4) in its parent; raises `CallFailed`, or `ValueError` for another shape."""
        self.set_all({(child, parent): pose}, static=static)

    def set_all(self, poses: Mapping[tuple[str, str], ArrayLike], *, static: bool = False) -> None:
        """Set the poses of many frames, by frame and parent, in one call. Raises like `set`."""
        stamp = now()
        _succeeded(self.send([transform_of(*names, pose, stamp, static=static) for names, pose in poses.items()]))

    def delete(self, child: str, parent: str) -> None:
        """Delete the transforms between two frames (``*``: any); raises `CallFailed` if there is none."""
        _succeeded(self.remove(child, parent))

    def __contains__(self, name: object) -> bool:
        return name in self.tree()

    def __iter__(self) -> Iterator[str]:
        return iter(self.tree().names())

    @override
    def tree(self) -> FrameTree:
        """Return all current frames; without a stream, raises `OSError` or `CallFailed` if the request fails."""
        if self._input is None:
            return FrameTree(self._fetch())
        if not self._input.connections.inputs:
            self._reconnect()
        with self._arrival:
            newest = self._newest
            if newest is None:
                return self._tree
            arrived_at, payload = newest
            if self._tree_of != arrived_at:
                self._tree, self._tree_of = FrameTree(self._parse(payload)), arrived_at
            if time.monotonic() - arrived_at > LIFETIME and any(not t.isStatic for t in self._tree.transforms):
                self._tree = FrameTree(t for t in self._tree.transforms if t.isStatic)
            return self._tree

    @override
    def send(self, transforms: list[FrameTransform]) -> ReturnValue:
        remote = self._setter.remote
        return remote.setTransformRPC(transforms[0]) if len(transforms) == 1 else remote.setTransformsRPC(transforms)

    @override
    def remove(self, first: str, second: str) -> ReturnValue:
        return self._setter.remote.deleteTransformRPC(first, second)

    @override
    def remove_all(self) -> ReturnValue:
        return self._setter.remote.clearAllRPC()

    @override
    def wait_until(self, known: Callable[[FrameTree], bool], timeout: float) -> bool:
        deadline = time.monotonic() + timeout
        while not known(self.tree()):
            if time.monotonic() >= deadline:
                return False
            self._await(deadline)
        return True

    def _await(self, deadline: float) -> None:
        """Wait for the next message, or without a stream until the next request is due."""
        left = max(deadline - time.monotonic(), 0.0)
        with self._arrival:
            self._arrival.wait(min(left, _POLL if self._input is None else _RECONNECT_INTERVAL))

    def _fetch(self) -> list[FrameTransform]:
        outcome, transforms = self._getter.remote.getTransformsRPC()
        _succeeded(outcome)
        return transforms

    def _on_message(self, message: PortMessage) -> None:
        """Store a streamed message; called on its connection's thread."""
        with self._arrival:
            self._newest = time.monotonic(), message.payload
            self._arrival.notify_all()

    def _parse(self, payload: Buffer) -> list[FrameTransform]:
        """Decode a streamed message in the format of the YARP release that the server's replies showed."""
        generation = self._getter.generation
        if generation is not Generation.YARP_3_11:
            return tf.AllTransforms.from_bytes(payload).transforms_list
        source, message = ElementReader(payload, generation.profile, generation), tf.AllTransforms()
        message._read(source)
        source.finish()
        return message.transforms_list

    def _reconnect(self) -> None:
        """Reconnect the stream of a server that has restarted."""
        if self._input is None or time.monotonic() < self._retry_at:
            return
        self._retry_at = time.monotonic() + _RECONNECT_INTERVAL
        try:
            connections.connect(self._naming, self._streamed, self._input.name)
        except (PortError, OSError):
            return


def _port(prefix: str, part: str) -> str:
    return prefix and prefix + part.replace("_nws_", "_nwc_")


def _succeeded(outcome: ReturnValue) -> None:
    if not outcome:
        raise CallFailed(outcome.code, "the transform server refused the call; see its log")


__all__ = ["TransformClient", "TransformError"]
