"""Endpoints that rcl or DDS refuses, with the topic and the likely cure.

In a secured domain a refusal is remembered: Fast DDS has read the enclave's permissions when the participant was
created, and logs several lines whenever it refuses an endpoint (Fast DDS 2.14.5, Permissions.cpp).
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation

from bridge.adapters.ros2 import security
from bridge.messages.errors import MessageTypeError

REMEMBERED_SECONDS = 60.0
"""Seconds until DDS is asked again."""

_MOST = 4096

_rclpy: Any = rclpy_implementation


class Refusals:
    """The refusals of one participant. Not thread-safe."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._secured = security.is_enabled(os.environ)
        self._remembered: dict[tuple[str, str, str], tuple[float, str]] = {}

    @contextlib.contextmanager
    def explained(self, kind: str, name: str, type_name: str) -> Iterator[None]:
        """Raise `MessageTypeError` for rcl's error, which mentions only types and allocators.

        ``kind`` distinguishes the endpoints of one topic or service. A remembered refusal is raised at once.
        """
        key = kind, name, type_name
        at, reason = self._remembered.get(key, (0.0, ""))
        if reason and self._clock() - at < REMEMBERED_SECONDS:
            raise MessageTypeError(reason, security.refusal(os.environ))
        try:
            yield
        except (_rclpy.RCLError, ValueError) as err:
            reason = f"ROS 2 does not accept {name} as {type_name}: {err}"
            if self._secured:
                if len(self._remembered) >= _MOST:
                    self._remembered.clear()
                self._remembered[key] = self._clock(), reason
            cure = security.refusal(os.environ) or "rename it with a rule, unless it recovers by itself within seconds"
            raise MessageTypeError(reason, cure) from err
        self._remembered.pop(key, None)
