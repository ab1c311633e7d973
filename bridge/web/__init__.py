"""The console: a page in the browser that shows a deployment and drives its robots; see docs/operate/console.md."""

from bridge.descriptors import DIAGNOSTICS, NODE, WorkerDescriptor

WORKER = WorkerDescriptor(
    name="web",
    factory="bridge.web.worker:WebWorker",
    section="bridge.web.section:WebSection",
    about="The console in the browser; see docs/operate/console.md.",
    sections=frozenset({"routing"}) | NODE | DIAGNOSTICS,
    uses="bridge.web.section:certificate_keys",
    needs=("starlette", "uvicorn", "websockets"),
    extra="web",
    checks="bridge.web.checks:CHECKS",
)
