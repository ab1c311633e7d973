"""Whether the zenoh worker starts, and the environment of its process."""

from __future__ import annotations

from collections.abc import Mapping

from bridge.config.model import Config
from bridge.config.sections.section import Enabled


def available(config: Config) -> str:
    """Return why the worker cannot start; "" if a dialect is configured."""
    return "" if config.zenoh.dialects else "no dialect is configured (zenoh.dialects)"


def enabled(config: Config) -> Enabled:
    """Return the key's value, or False if no dialect is configured."""
    return config.zenoh.enabled if config.zenoh.dialects else False


def worker_environment(config: Config, environ: Mapping[str, str]) -> dict[str, str]:  # noqa: ARG001 - same signature for every side
    """Return the environment of a zenoh worker, derived from the environment of its parent."""
    return {**environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}  # prevents the ROS wheels from restarting Python
