"""What a YARP worker's process needs of its environment, and whether there is anything for it to do."""

from __future__ import annotations

from collections.abc import Mapping

from bridge.config.model import Config
from yarp_compat.naming import config as conf
from yarp_compat.naming.errors import ConfigError


def available(config: Config) -> str:
    """Nothing where YARP is used here; else why the worker has nothing to do."""
    if config.yarp.configured:
        return ""
    try:
        known = conf.read(config.yarp.namespace)
    except ConfigError as err:
        return str(err)
    return "" if known is not None else f"YARP is not used here: there is no {conf.file(config.yarp.namespace)}"


def worker_environment(config: Config, environ: Mapping[str, str]) -> dict[str, str]:
    """The environment for a YARP worker, made from that of its parent."""
    env = {**environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}  # spares the wheels' second start of Python
    if config.yarp.namespace is not None:
        env["YARP_NAMESPACE"] = config.yarp.namespace
    return env
