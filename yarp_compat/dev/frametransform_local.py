"""Transforms that one program keeps for itself, as YARP's ``frameTransformStorage`` does."""

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

_AGAIN = 0.01  # seconds between two looks at what may have expired
_ANY = "*"


class LocalTransforms(IFrameTransform):
    """Keeps transforms; those that are not static are forgotten after ``lifetime`` seconds without an update."""

    def __init__(self, lifetime: float = LIFETIME) -> None:
        self._lifetime = lifetime
        self._kept: dict[tuple[str, str], FrameTransform] = {}
        self._changed = threading.Condition()

    def tree(self) -> FrameTree:
        """All frames as they are known now."""
        oldest = now() - self._lifetime
        with self._changed:
            for key in [key for key, t in self._kept.items() if not t.isStatic and t.timestamp < oldest]:
                del self._kept[key]
            return FrameTree(self._kept.values())

    def send(self, transforms: list[FrameTransform]) -> ReturnValue:
        """Keep transforms in place of older ones between the same frames."""
        with self._changed:
            self._kept.update({(t.src_frame_id, t.dst_frame_id): t for t in transforms})
            self._changed.notify_all()
        return OK

    def forget(self, one: str, other: str) -> ReturnValue:
        """Forget what is between two frames, whichever is the parent; false where nothing is."""
        with self._changed:
            found = [key for key in self._kept if _between(key, one, other) or _between(key, other, one)]
            for key in found:
                del self._kept[key]
        return OK if found else ReturnValue(ReturnCode.METHOD_FAILED)

    def forget_all(self) -> ReturnValue:
        """Forget all transforms."""
        with self._changed:
            self._kept.clear()
        return OK

    def wait_until(self, known: Callable[[FrameTree], bool], timeout: float) -> bool:
        """Wait until something holds of the frames; whether it does in time."""
        deadline = time.monotonic() + timeout
        while not known(self.tree()):
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            with self._changed:
                self._changed.wait(min(left, _AGAIN))
        return True


def _between(key: tuple[str, str], one: str, other: str) -> bool:
    return all(asked in (_ANY, name) for asked, name in zip((one, other), key, strict=True))
