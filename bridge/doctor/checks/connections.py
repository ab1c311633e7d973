"""The connections to other machines (``hub.open``): certificates, a test of each endpoint, and the router's report."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from bridge.concurrency import WorkerPool
from bridge.doctor.check import Finding, Findings, Result, fail, ok, warn
from bridge.doctor.checks.keys import check_keys
from bridge.doctor.context import CheckContext
from bridge.hub.errors import HubError
from bridge.hub.security.external_router import external_tree, has_tls
from bridge.hub.security.handshake import HostPort, Identity, attempt
from bridge.hub.security.reasons import EndpointState, Reason
from bridge.hub.zenoh_config import connect_endpoint, make_config
from bridge.status import EndpointStatus, RouterStatus

_AT_ONCE = 8
"""Endpoints that are tested at the same time."""

SECONDS = 20.0
"""Time limit of the check in seconds; one test takes at most 10 s for each address."""


def check_connections(context: CheckContext) -> Findings:
    """Check the certificates of ``hub.open``, and that each of its endpoints connects."""
    opened = context.config.hub.open
    keys = check_keys(context)
    findings = [keys] if isinstance(keys, Finding) else list(keys)
    if not opened.opened:
        return findings
    if not has_tls(opened):
        findings = []
    try:
        identity = Identity.of(make_config(external_tree(context.config), opened.zenoh))
    except HubError:  # the keys' findings name the file
        identity = None
    reported = _router_report(context)
    if has_tls(opened) and identity is None:
        return [*findings, *(_of_router(state) for state in reported.values() if not _good(state))]
    ends = [("connect", endpoint) for endpoint in opened.connect] + [("listen", endpoint) for endpoint in opened.listen]
    # daemon threads, because the resolver may still hang when the command ends
    pool = WorkerPool(_AT_ONCE, "doctor-endpoints")
    tests = [
        pool.submit(partial(_test, direction, endpoint, identity, reported.get((direction, endpoint))))
        for direction, endpoint in ends
    ]
    return [*findings, *(test.result() for test in tests)]


def _test(direction: str, endpoint: str, identity: Identity | None, reported: EndpointStatus | None) -> Finding:
    """Test one endpoint; the router's report covers what a test cannot show, such as refused machines."""
    name = f"hub.open.{direction} {endpoint}"
    address = HostPort.of(connect_endpoint(endpoint))
    if address is None or not address.can_be_tested:
        return ok(f"{name}: only the router can test it") if reported is None else _of_router(reported)
    if direction == "listen" and reported is None:
        return Finding(Result.SKIP, f"{name}: the router does not run")
    if direction == "listen" and identity is not None:
        identity = replace(identity, verify_name=False)  # the certificate names this machine as others reach it
    result = attempt(address, identity)
    if result.reason.state is not EndpointState.CONNECTING:
        return _finding(f"{name}: {result.reason.state}: {result.reason.text}", result.reason)
    if reported is not None and not _good(reported):
        return _of_router(reported)
    tls = f"TLS with {result.machine or 'the other machine'} succeeds" if address.protocol == "tls" else "it answers"
    state = "" if reported is None else f", and the router reports {reported.state}"
    return ok(f"{name}: {tls}{state}")


def _finding(seen: str, reason: Reason) -> Finding:
    """Return a failure for a refusal, which does not end by itself; else a warning, as the machine may just be off."""
    return fail(seen, reason.cure) if reason.state is EndpointState.REFUSED else warn(seen, reason.cure)


def _router_report(context: CheckContext) -> dict[tuple[str, str], EndpointStatus]:
    """Return the endpoints in the status document of this daemon's router."""
    documents = context.hub.of_side("router", context.config.name)
    routers = [document for document in documents if isinstance(document, RouterStatus)]
    return {(endpoint.way, endpoint.endpoint): endpoint for router in routers for endpoint in router.endpoints}


def _good(endpoint: EndpointStatus) -> bool:
    return endpoint.state in [state for state in EndpointState if state.good]


def _of_router(endpoint: EndpointStatus) -> Finding:
    seen = f"hub.open.{endpoint.way} {endpoint.endpoint}: {endpoint.state}"
    if _good(endpoint):
        return ok(f"{seen}, according to the router")
    return warn(f"{seen}: {endpoint.reason}", endpoint.cure)
