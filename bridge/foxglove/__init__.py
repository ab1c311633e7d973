"""The server for the Foxglove app: a worker that serves the hub's topics with the library ``foxglove-sdk``."""

from bridge.descriptors import DIAGNOSTICS, NODE, WorkerDescriptor

WORKER = WorkerDescriptor(
    name="foxglove",
    factory="bridge.foxglove.worker:FoxgloveWorker",
    section="bridge.foxglove.section:FoxgloveSection",
    about="The server for the Foxglove app; see docs/operate/foxglove.md.",
    sections=frozenset({"routing", "web"}) | NODE | DIAGNOSTICS,
    needs=("foxglove",),
    extra="foxglove",
)
