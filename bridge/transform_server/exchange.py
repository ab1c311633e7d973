"""Exchanges frames between YARP programs and the hub."""

from __future__ import annotations

import logging
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from bridge.tf.buffer import TransformBuffer
from bridge.tf.errors import FrameRefusal
from bridge.tf.history import pose_flaw
from bridge.tf.layout import DONE
from bridge.tf.stamped import Stamped, read, write
from bridge.transform_server.view import ANY, View, YarpClock
from yarp_compat.dev.frametransform import FrameTransform

_log = logging.getLogger(__name__)

YARP = "yarp"
"""The authority of frames that YARP programs set."""

_HARMLESS = (None, FrameRefusal.OLD_DATA, FrameRefusal.REPEATED_DATA)
"""Outcomes that are not errors for the client, because YARP's own server silently keeps the newest transform."""

_LAST_SECOND = float(1 << 31)  # the seconds of builtin_interfaces/Time are a signed 32-bit integer

Publish = Callable[[bytes], None]


class Exchange:
    """Passes frames from YARP programs to the hub and vice versa. Safe to use from any thread.

    Args:
        publish: publishes a message with timed frames that YARP programs set.
        publish_static: publishes a latched message with all static frames that YARP programs set.
    """

    def __init__(
        self, buffer: TransformBuffer, view: View, clock: YarpClock, publish: Publish, publish_static: Publish
    ) -> None:
        self.buffer, self.view = buffer, view
        self.ignored: Counter[str] = Counter()
        """Number of valid transforms from YARP programs that were ignored, by reason."""
        self._clock = clock
        self._publish, self._publish_static = publish, publish_static
        self._lock = threading.Lock()

    def set(self, transforms: Sequence[FrameTransform]) -> FrameRefusal | None:
        """Insert the transforms that a YARP program sets, and publish them.

        Transforms that have expired on arrival are ignored. A timed transform of a static frame is ignored too, until
        that frame is deleted.

        Returns:
            None, or why one of the transforms was refused; the others are inserted.
        """
        with self._lock:
            sound = [t for t in transforms if 0.0 <= t.timestamp < _LAST_SECOND]
            flaw = None if len(sound) == len(transforms) else FrameRefusal.INVALID_STAMP
            flaw = self._set([t for t in sound if not t.isStatic and self._is_current(t)], static=False) or flaw
            return self._set([t for t in sound if t.isStatic], static=True) or flaw

    def frames(self) -> list[FrameTransform]:
        """Return all frames that YARP programs currently see."""
        with self._lock:
            return self.view.frames()

    def delete(self, first: str, second: str) -> bool:
        """Delete the transforms between two frames, if YARP programs have set them; return whether there were any."""
        with self._lock:
            static = sum(1 for _ in self.view.own_static())
            first, second = _plain(first), _plain(second)
            deleted = self.view.delete(first, second)
            for child in deleted:
                self.buffer.remove(child)
            if static != sum(1 for _ in self.view.own_static()):
                self._publish_static_frames()
            if not deleted and ANY not in (first, second) and self.view.is_from_hub(first, second):
                _log.warning("YARP programs cannot delete %s, %s: another side publishes it", first, second)
        return bool(deleted)

    def receive(self, cdr: bytes, authority: str, *, static: bool) -> None:
        """Insert a message that ``authority`` published on the hub."""
        stamped = read(cdr)
        with self._lock:
            for transform, refusal in zip(
                stamped, self.buffer.set_transforms(stamped, authority, static=static), strict=True
            ):
                if refusal is None or refusal is FrameRefusal.REPEATED_DATA:  # a repetition confirms the transform
                    self.view.set_from_hub(transform, static=static)

    def forget_timed(self) -> None:
        """Remove all but static frames, because time was set back."""
        with self._lock:
            self.buffer.clear()
            self.view.forget_timed()

    def _is_current(self, transform: FrameTransform) -> bool:
        if self.view.is_static(_plain(transform.dst_frame_id)):
            self.ignored["static"] += 1
            return False
        if self._clock.age(transform.timestamp) <= self.view.yarp_lifetime:
            return True
        self.ignored["expired"] += 1
        if self.ignored["expired"] == 1:
            _log.warning(
                "the transform of %r arrived expired, %.3f s after its stamp: synchronize the clocks, or set"
                " modules.transform_server.yarp_frame_lifetime (further ones are only counted)",
                transform.dst_frame_id,
                self._clock.age(transform.timestamp),
            )
        return False

    def _set(self, transforms: list[FrameTransform], *, static: bool) -> FrameRefusal | None:
        if not transforms:
            return None
        stamped = [self._to_stamped(transform) for transform in transforms]
        if static:
            self._reset_frames(stamped)
        refusals = self.buffer.set_transforms(stamped, YARP, static=static)
        inserted = []
        for transform, published, refusal in zip(transforms, stamped, refusals, strict=True):
            if refusal is None:
                self.view.remember_spelling(transform.src_frame_id)
                self.view.remember_spelling(transform.dst_frame_id)
                shown = replace(transform, timestamp=self._clock.to_readers(transform.timestamp))
                self.view.set(shown, published)
                inserted.append(published)
        if inserted and static:
            self._publish_static_frames()
        elif inserted:
            self._publish(write(inserted))
        return next((refusal for refusal in refusals if refusal not in _HARMLESS), None)

    def _reset_frames(self, stamped: Iterable[Stamped]) -> None:
        """Remove the histories of frames that become static, because each keeps the kind of its first transform.

        The history of a frame whose new transform will be refused stays.
        """
        for parent, child, _, moved, turned in stamped:
            valid = parent not in ("", child) and pose_flaw(*moved, *turned) == DONE
            if valid and not self.view.is_static(child):
                self.buffer.remove(child)

    def _to_stamped(self, transform: FrameTransform) -> Stamped:
        moved, turned = (
            (transform.tX, transform.tY, transform.tZ),
            (transform.qX, transform.qY, transform.qZ, transform.qW),
        )
        parent, child = _plain(transform.src_frame_id), _plain(transform.dst_frame_id)
        return Stamped(parent, child, self._clock.to_run_ns(transform.timestamp), moved, turned)

    def _publish_static_frames(self) -> None:
        self._publish_static(write(self._to_stamped(transform) for transform in self.view.own_static()))


def _plain(name: str) -> str:
    """Return a name in tf2's form: without a leading slash, and valid UTF-8."""
    return (name if name.isascii() else name.encode("utf-8", "replace").decode()).lstrip("/")
