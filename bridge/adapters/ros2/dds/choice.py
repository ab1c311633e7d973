"""Chooses the DDS implementation of the worker's participant."""

from __future__ import annotations

from bridge.adapters.ros2.context import Dds
from bridge.adapters.ros2.dds.cyclone import CycloneDds
from bridge.adapters.ros2.dds.fast import FastDds
from bridge.adapters.ros2.environment import CYCLONE
from bridge.config.model import Config


def dds_of(config: Config) -> Dds:
    """Return the implementation that ``ros2.rmw`` names."""
    return CycloneDds(config) if config.ros2.rmw == CYCLONE else FastDds(config)
