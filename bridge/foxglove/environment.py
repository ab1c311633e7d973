"""Whether the server for the Foxglove app can run on this machine, and in which environment."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Mapping

from bridge.config.model import Config


def available(_config: Config) -> str:
    """Why it cannot run here, "" where it can."""
    if importlib.util.find_spec("foxglove") is None:
        return "foxglove-sdk cannot be imported; pip install 'midspan[foxglove]'"
    return ""


def worker_environment(_config: Config, environ: Mapping[str, str] = os.environ) -> dict[str, str]:
    """The environment of its process."""
    return {**environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}  # spares the wheels' second start of Python
