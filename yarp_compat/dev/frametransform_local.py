"""Transforms that a program stores locally, as YARP's ``frameTransformStorage`` does."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from yarp_compat.dev.frametransform import FrameTransform
from yarp_compat.dev.frametransform_client import LIFETIME
from yarp_compat.dev.frametree import FrameTree
from yarp_compat.dev.iframetransform import IFrameTransform
from yarp_compat.dev.returnvalue import OK, ReturnCode, ReturnValue
from yarp_compat.os.time import now
from yarp_compat.overriding import override

_POLL = 0.01  # seconds between checks for expired transforms
_ANY = "*"


class LocalTransforms(IFrameTransform):
    """A store of transforms; those that are not static expire ``lifetime`` seconds after their time stamp."""

    def __init__(self, lifetime: float = LIFETIME) -> None:
        self._lifetime = lifetime
        self._transforms: dict[tuple[str, str], FrameTransform] = {}
        self._changed = threading.Condition()

    @override
    def tree(self) -> FrameTree:
        oldest = now() - self._lifetime
        with self._changed:
            for key in [key for key, t in self._transforms.items() if not t.isStatic and t.timestamp < oldest]:
                del self._transforms[key]
            return FrameTree(self._transforms.values())

    @override
    def send(self, transforms: list[FrameTransform]) -> ReturnValue:
        """Store transforms; they replace older ones between the same frames."""
        with self._changed:
            self._transforms.update({(t.src_frame_id, t.dst_frame_id): t for t in transforms})
            self._changed.notify_all()
        return OK

    @override
    def remove(self, first: str, second: str) -> ReturnValue:
        """Delete the transforms between two frames, whichever is the parent; fail if there are none."""
        with self._changed:
            keys = [key for key in self._transforms if _between(key, first, second) or _between(key, second, first)]
            for key in keys:
                del self._transforms[key]
        return OK if keys else ReturnValue(ReturnCode.METHOD_FAILED)

    @override
    def remove_all(self) -> ReturnValue:
        with self._changed:
            self._transforms.clear()
        return OK

    @override
    def wait_until(self, known: Callable[[FrameTree], bool], timeout: float) -> bool:
        deadline = time.monotonic() + timeout
        while not known(self.tree()):
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            with self._changed:
                self._changed.wait(min(left, _POLL))
        return True


def _between(key: tuple[str, str], parent: str, child: str) -> bool:
    return all(pattern in (_ANY, name) for pattern, name in zip((parent, child), key, strict=True))
