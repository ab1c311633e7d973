"""The services of parameters that every ROS 2 node has (rcl_interfaces, Jazzy)."""

from __future__ import annotations

from bridge.messages.calls import ServiceCodec
from bridge.messages.registry import Registry

SERVICES = {
    "get_parameters": "GetParameters",
    "get_parameter_types": "GetParameterTypes",
    "list_parameters": "ListParameters",
    "describe_parameters": "DescribeParameters",
    "set_parameters": "SetParameters",
    "set_parameters_atomically": "SetParametersAtomically",
}
"""What follows the node's name, and the type."""


def codecs(registry: Registry) -> dict[str, ServiceCodec]:
    """The codecs of the services, by what follows the node's name."""
    return {word: ServiceCodec(registry, f"rcl_interfaces/srv/{name}") for word, name in SERVICES.items()}
