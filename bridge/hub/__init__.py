"""The hub: a ROS 2 graph over zenoh in the wire format of Jazzy's rmw_zenoh.

Example: a node with a publisher of serialized messages (CDR); `bridge.client` and `bridge.modules` use Python values::

    from bridge.hub.node import Hub
    from bridge.hub.session import HubSettings
    from bridge.hub.wire.qos import Qos
    from bridge.messages.json import from_json
    from bridge.messages.registry import Registry

    registry, kind = Registry(), "std_msgs/msg/Bool"
    with Hub.open(HubSettings(router="tcp/127.0.0.1:7447", node="switch")) as hub:
        publisher = hub.publisher("/lamp/on", kind, registry.ros2(kind).type_id, Qos())
        input("Press Enter once there is a subscriber.")
        publisher.put(from_json(registry, kind, {"data": True}))
"""

from bridge.descriptors import WorkerDescriptor

WORKER = WorkerDescriptor(
    name="router",
    factory="bridge.hub.router:create_router",
    switch="bridge.hub.settings:router_enabled",
    uses="bridge.hub.settings:router_uses",
    outlives=True,
    checks="bridge.doctor.checks.router:CHECKS",
)
