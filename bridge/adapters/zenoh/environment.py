"""What a zenoh worker's process needs of its environment, and whether there is anything for it to do."""

from __future__ import annotations

from collections.abc import Mapping

from bridge.config.model import Config


def available(config: Config) -> str:
    """Nothing where a dialect is configured; else why the worker has nothing to do."""
    return "" if config.zenoh.dialects else "no dialect is configured (zenoh.dialects)"


def worker_environment(config: Config, environ: Mapping[str, str]) -> dict[str, str]:  # noqa: ARG001 - as every side's
    """The environment for a zenoh worker, made from that of its parent."""
    return {**environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}  # spares the wheels' second start of Python
