"""Whether the console can run on this machine, and in which environment."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Mapping

from bridge.config.model import Config

NEEDS = ("starlette", "uvicorn", "websockets")


def available(_config: Config) -> str:
    """Why it cannot run here, "" where it can."""
    missing = [name for name in NEEDS if importlib.util.find_spec(name) is None]
    return f"{', '.join(missing)} cannot be imported; pip install 'midspan[web]'" if missing else ""


def worker_environment(_config: Config, environ: Mapping[str, str] = os.environ) -> dict[str, str]:
    """The environment of its process."""
    return {**environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}  # spares the wheels' second start of Python
