"""A simulated mobile base in DART: floor plans, the R1's base, laser and depth camera, on the hub and on YARP."""

from bridge.descriptors import NODE, WorkerDescriptor

WORKER = WorkerDescriptor(
    name="sim",
    factory="sim.simulator:SimWorker",
    section="sim.section:SimSection",
    about="The simulated base.",
    sections=NODE | {"yarp"},
    environment="sim.environment",
)
