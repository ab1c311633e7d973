"""The compiled parts of ROS 1 connections (``intake.c``, ``topics/outputs.c``); None if they were not compiled.

They are also missing if the system lacks ``epoll``; then everything is read and sent in Python.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

try:
    from bridge.adapters.ros1.intake import Intake, Stream
    from bridge.adapters.ros1.topics.outputs import Outputs, Socket
except ImportError:
    if not TYPE_CHECKING:
        Intake = Stream = Outputs = Socket = None

__all__ = ["Intake", "Outputs", "Socket", "Stream"]
