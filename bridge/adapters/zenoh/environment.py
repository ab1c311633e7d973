"""Whether a zenoh worker has anything to do, and the environment of its process."""

from __future__ import annotations

from collections.abc import Mapping

from bridge.config.model import Config
from bridge.config.sections.section import Enabled


def available(config: Config) -> str:
    """Why the worker has nothing to do; "" where a dialect is configured."""
    return "" if config.zenoh.dialects else "no dialect is configured (zenoh.dialects)"


def enabled(config: Config) -> Enabled:
    """Off where no dialect is configured, whatever the key says."""
    return config.zenoh.enabled if config.zenoh.dialects else False


def worker_environment(config: Config, environ: Mapping[str, str]) -> dict[str, str]:  # noqa: ARG001 - as every side's
    """The environment for a zenoh worker, made from that of its parent."""
    return {**environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}  # spares the wheels' second start of Python
