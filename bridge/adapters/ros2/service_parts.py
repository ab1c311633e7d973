"""What clients and servers of an edge have in common."""

from __future__ import annotations

from dataclasses import dataclass

from bridge.adapters.ros2.graph import Graph
from bridge.adapters.ros2.lives import Lives
from bridge.adapters.ros2.loop import Loop
from bridge.adapters.ros2.participant import Participant
from bridge.adapters.ros2.service_later import Later


@dataclass(frozen=True, slots=True)
class Parts:
    """The edge's parts that a client or a server stands on."""

    participant: Participant
    loop: Loop
    graph: Graph
    lives: Lives
    later: Later
