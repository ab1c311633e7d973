"""Whether a YARP worker has anything to do, and the environment of its process."""

from __future__ import annotations

from collections.abc import Mapping

from bridge.config.model import Config
from bridge.config.sections.section import Enabled
from yarp_compat.naming import config as conf
from yarp_compat.ports.naming import NamingConfigError


def available(config: Config) -> str:
    """Why the worker has nothing to do; "" where YARP is used here."""
    if config.yarp.configured:
        return ""
    try:
        known = conf.read(config.yarp.namespace)
    except NamingConfigError as err:
        return str(err)
    return "" if known is not None else f"YARP is not used here: there is no {conf.file(config.yarp.namespace)}"


def enabled(config: Config) -> Enabled:
    """Off where it is ``auto`` and YARP is not used here, so that no one reads of a side that they do not miss."""
    return False if config.yarp.enabled == "auto" and available(config) else config.yarp.enabled


def worker_environment(config: Config, environ: Mapping[str, str]) -> dict[str, str]:
    """The environment for a YARP worker, made from that of its parent."""
    env = {**environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}  # spares the wheels' second start of Python
    if config.yarp.namespace is not None:
        env["YARP_NAMESPACE"] = config.yarp.namespace
    return env
