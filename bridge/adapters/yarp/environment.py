"""Whether a YARP worker is needed, and the environment of its process."""

from __future__ import annotations

from collections.abc import Mapping

from bridge.config.model import Config
from bridge.config.sections.section import Enabled
from yarp_compat.naming import config as conf
from yarp_compat.ports.naming import NamingConfigError


def available(config: Config) -> str:
    """Return why the worker is not needed, or cannot read yarp.conf; "" if YARP is used on this machine."""
    if config.yarp.configured:
        return ""
    try:
        known = conf.read(config.yarp.namespace)
    except NamingConfigError as err:
        return str(err)
    return "" if known is not None else f"YARP is not used here: {conf.file(config.yarp.namespace)} not found"


def enabled(config: Config) -> Enabled:
    """Return the setting; off for ``auto`` without YARP, so that users do not see an unused side."""
    return False if config.yarp.enabled == "auto" and available(config) else config.yarp.enabled


def worker_environment(config: Config, environ: Mapping[str, str]) -> dict[str, str]:
    """Return the environment for a YARP worker, derived from the environment of its parent."""
    env = {**environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}  # prevents the ROS wheels from restarting Python
    if config.yarp.namespace is not None:
        env["YARP_NAMESPACE"] = config.yarp.namespace
    return env
