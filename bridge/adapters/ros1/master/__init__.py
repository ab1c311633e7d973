"""A ROS 1 master: names, registrations, parameters, and the calls to nodes that follow from them."""

from bridge.descriptors import WorkerDescriptor

WORKER = WorkerDescriptor(
    name="ros1_master",
    factory="bridge.adapters.ros1.master.worker:MasterWorker",
    switch="bridge.adapters.ros1.environment:master_enabled",
    sections=frozenset({"ros1"}),
    outlives=True,
    node=False,
)
