"""What the simulator's worker needs of this machine."""

from __future__ import annotations

from collections.abc import Mapping

from bridge.config.model import Config
from sim.dart import missing
from sim.errors import SimError


def available(config: Config) -> str:  # noqa: ARG001 - as all workers are asked
    """Why it cannot run here, "" where it can."""
    return missing()


def worker_environment(config: Config, environ: Mapping[str, str]) -> dict[str, str]:  # noqa: ARG001 - as above
    """Its process's environment; raises `SimError` where it cannot run."""
    if why := missing():
        raise SimError(why)
    return {**environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}  # spares the wheels' second start of Python
