"""Records selected topics of the hub to files."""

from bridge.descriptors import NODE, WorkerDescriptor

WORKER = WorkerDescriptor(
    name="record",
    factory="bridge.record.worker:RecordWorker",
    section="bridge.record.section:RecordSection",
    about="Recording into files; see docs/operate/record.md.",
    sections=NODE | {"yarp"},
)
