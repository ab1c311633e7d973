"""Hosted modules: nodes on the hub that Midspan itself runs, such as the YARP navigation modules.

Example of your own module, which the configuration names in ``modules.own``::

    from bridge.modules.module import Module

    class Lamp(Module):
        name = "lamp"

        def start(self, host, section):
            self.state = host.node.publisher("/lamp/state", "std_msgs/msg/Bool")
            host.node.server("/lamp", "std_srvs/srv/SetBool", self.switch)

        def switch(self, request, answer):
            self.state.publish({"data": request["data"]})
            answer({"success": True})
"""

from bridge.descriptors import DIAGNOSTICS, NODE, WorkerDescriptor

WORKER = WorkerDescriptor(
    name="modules",
    factory="bridge.modules.worker:ModulesWorker",
    switch="bridge.modules.settings:enabled",
    sections=frozenset({"modules", "store", "yarp"}) | NODE | DIAGNOSTICS,
    hosts=True,
)
