"""Joins the DDS network: the settings of the middleware, then the participant."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

from bridge.adapters.ros2.cyclonedds import use_settings
from bridge.adapters.ros2.environment import CYCLONE, domain
from bridge.adapters.ros2.participant import Participant
from bridge.adapters.ros2.profile import addresses, static_peers, use_profile
from bridge.config.model import Config


class Joined(NamedTuple):
    """The participant, its GUID prefix, and the bytes of its shared memory."""

    participant: Participant
    prefix: bytes
    segment: int


def join(config: Config, state: Path, node: str) -> Joined:
    """Create the participant with one node; a process can have only one."""
    if config.ros2.rmw == CYCLONE:
        use_settings(config, tuple(addresses(static_peers(os.environ))))
        participant = Participant(node, domain(config, os.environ))
        assert participant.prefix is not None
        return Joined(participant, participant.prefix, 0)
    profile = use_profile(config, state)
    return Joined(Participant(node, domain(config, os.environ)), profile.prefix, profile.segment)
