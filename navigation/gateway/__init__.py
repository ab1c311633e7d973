"""The gateway: one navigation interface for the clients of all sides, over any planner."""

from bridge.descriptors import ModuleDescriptor

MODULE = ModuleDescriptor(
    name="gateway",
    factory="navigation.gateway.module:GatewayModule",
    cause="navigation.gateway.checks:cause",
)
