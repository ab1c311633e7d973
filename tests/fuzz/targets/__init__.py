"""All targets by name."""

from __future__ import annotations

from tests.fuzz.target import Target
from tests.fuzz.targets import (
    bags,
    cli,
    config,
    daemon,
    definitions,
    foxglove,
    hub,
    interfaces,
    messages,
    octomap,
    ros1,
    ros1_calls,
    ros1_master,
    ros2,
    web,
    yarp_bottle,
    yarp_data,
    yarp_messages,
    yarp_names,
    yarp_ports,
    zenoh,
)

_MODULES = (
    bags,
    messages,
    octomap,
    definitions,
    interfaces,
    ros1,
    ros1_calls,
    ros1_master,
    ros2,
    hub,
    web,
    foxglove,
    config,
    daemon,
    cli,
    zenoh,
    yarp_bottle,
    yarp_data,
    yarp_messages,
    yarp_names,
    yarp_ports,
)

TARGETS: dict[str, Target] = {target.name: target for module in _MODULES for target in module.TARGETS}
