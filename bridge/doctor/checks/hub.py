"""The configuration, the daemon and its workers, the router's port, and the keys by which machines join."""

from __future__ import annotations

import ssl
from collections.abc import Container, Iterator, Mapping, Sequence
from itertools import combinations, product

import psutil

from bridge.config.document import ConfigError
from bridge.config.listeners import listeners
from bridge.config.load import load
from bridge.config.model import Config
from bridge.daemon.query import Phase
from bridge.daemon.units import STATE, log_hint, start_hint, units_in_use
from bridge.descriptors import all_modules
from bridge.doctor.causes import cause, grouped, shared
from bridge.doctor.check import Finding, Findings, early_cure, fail, ok, skip, warn
from bridge.doctor.context import CheckContext
from bridge.doctor.daemon_state import restarted, unresponsive_router
from bridge.doctor.hub_problems import Note
from bridge.hub import WORKER as ROUTER
from bridge.hub.errors import HubConfigError, HubError
from bridge.hub.router import port_held, port_holder, probe_router
from bridge.hub.security.certificates import Certificate, CertificateError, read_certificate, signed_by
from bridge.hub.security.external_router import has_tls, key_files
from bridge.hub.security.key_files import KeyFiles
from bridge.registration import imported
from bridge.state_file import named
from bridge.status import ModuleStatus, RouterStatus, StatusDocument

_HUB = "hub.listen"
_COMES = {phase.value for phase in (Phase.QUEUED, Phase.STARTING, Phase.PAUSED)}
"""The states that the daemon reports for a worker that does not answer on the hub yet."""


def check_config(context: CheckContext) -> Findings:
    """Report the file's problems, and a hub that is open to other machines without TLS."""
    if not context.config_good:
        return [fail(line, "correct it ('midspan config check')") for line in context.config_text.splitlines()]
    findings = [ok(context.config_text)]
    listener = context.config.hub.open
    if listener.insecure:
        endpoints = ", ".join((*listener.listen, *listener.connect))
        seen = f"the hub is open without TLS at {endpoints}: any machine that reaches it can join"
        findings.append(warn(seen, "certificates ('midspan keys'), and tls/ endpoints in hub.open"))
    return findings


def check_services(context: CheckContext) -> Findings:
    """Check the daemons that run as services here: their configurations, and resources that two cannot share."""
    units = units_in_use(context.root)
    if len(units) < 2:
        return skip("fewer than two daemons run as services here")
    findings: list[Finding] = []
    configs: dict[str, Config] = {}
    for unit, file in units.items():
        try:
            config = named(load(file), {"STATE_DIRECTORY": str(context.root / STATE.relative_to("/"))})
        except ConfigError as err:
            findings += [fail(f"{unit}: {line}", f"midspan config check {file}") for line in str(err).splitlines()]
            continue
        findings.append(ok(f"{unit} is the daemon {config.name} ({file})"))
        configs[unit] = config
    return [*findings, *_shared_settings(configs), *_shared_ports(configs)]


def _shared_settings(configs: Mapping[str, Config]) -> Iterator[Finding]:
    """Yield a finding for each name and address that several daemons have, except a hub that they share."""
    claims: dict[tuple[str, str], list[str]] = {}
    for unit, config in configs.items():
        places = [
            (listener.key, listener.text) for listener in listeners(config) if listener.port and listener.key != _HUB
        ]
        for claim in dict.fromkeys([("name", config.name), *places]):
            claims.setdefault(claim, []).append(unit)
    for (key, value), owners in claims.items():
        if len(owners) > 1:
            seen = f"{' and '.join(owners)} have the same {key}: {value}"
            yield fail(seen, f"give each of them its own {key}")


def _shared_ports(configs: Mapping[str, Config]) -> Iterator[Finding]:
    """Yield a finding for each pair of addresses of two daemons that share a port.

    This leaves out pairs that `_shared_settings` reports, and pairs of ``hub.listen``, because daemons may share a hub.
    """
    for (first_unit, first), (other, second) in combinations(configs.items(), 2):
        for place, taken in product(listeners(second), listeners(first)):
            alike = place.key == taken.key and (place.text == taken.text or place.key == _HUB)
            if place.excludes(taken) and not alike:
                seen = (
                    f"{place.key} of {other} ({place.text}) has the port of {taken.key} of {first_unit} ({taken.text})"
                )
                yield fail(seen, "set another port in one of them")


def check_workers(context: CheckContext) -> Findings:
    """Check the daemon itself, and the state of each worker."""
    hub, state = context.hub, context.daemon
    missing = [fail(state.trouble, state.cure)] if state.trouble else []
    if hub.error:
        absent = [_worker(context, document) for document in hub.documents]
        cure = "" if absent or missing else start_hint(state.unit)
        return [*missing, warn(hub.error.splitlines()[0], cure), *absent]
    if not hub.documents:
        listen, domain = context.config.hub.listen, context.config.hub.domain
        seen = f"a router answers at {listen}, but no worker does in domain {domain}"
        return [*missing, warn(seen, "start the daemon: midspan run; if it runs, compare hub.domain")]
    findings = list(missing)
    for daemon in dict.fromkeys(document.daemon for document in hub.documents):
        workers = [document for document in hub.documents if document.daemon == daemon]
        common = shared({document.worker: document.warnings for document in workers})
        findings += _alone(context, daemon, workers)
        findings += [_worker(context, document, common) for document in workers]
        for text, names in common.values():
            findings.append(warn(f"{', '.join(f'{daemon}/{name}' for name in names)}: {text}"))
    return findings


def _alone(context: CheckContext, daemon: str, workers: Sequence[StatusDocument]) -> list[Finding]:
    """Return a warning if only the router of a daemon of another name answers: a router outlives its daemon."""
    if daemon == context.config.name or [document.worker for document in workers] != [ROUTER.name]:
        return []
    seen = f"only the router of {daemon} answers: the daemon is down, or runs nothing else"
    return [warn(seen, f"on its machine: 'midspan status'; {start_hint('midspan')}")]


def _worker(context: CheckContext, document: StatusDocument, elsewhere: Container[str] = ()) -> Finding:
    """Return a finding on a worker's state, without the warnings whose causes are in ``elsewhere``."""
    name = f"{document.daemon}/{document.worker}"
    state, log = document.state, log_hint(context.daemon.unit)
    if document.error:
        return fail(f"{name} {'does not answer' if state == 'failed' else f'is {state}'}: {document.error}", log)
    if document.loops:
        return fail(f"{name} crashes again and again; it is now {state}: {document.text}", log)
    crashes = restarted(document.restarts, document.ended) if document.ended else ""
    again = f" ({crashes})" if crashes else ""
    warnings = [text for text in document.warnings if cause(text) not in elsewhere]
    if warnings:
        note = _cause(context, document)
        cure = note.cure if note is not None and any(note.text in warning for warning in warnings) else ""
        return warn(f"{name} is {state}{again}, and warns: {'; '.join(grouped(warnings))}", cure)
    if state == "waiting":
        return _waiting(context, document, name)
    if state in ("running", "standby"):
        return ok(f"{name} is {state}{again}")
    if state == Phase.FAILED.value:
        return fail(f"{name} {state}: {document.text}", log)
    if state in _COMES:
        crashed = state == Phase.PAUSED.value or document.restarts
        return warn(f"{name} is {state}: {document.text}", log if crashed else "wait")
    return skip(f"{name} reports {state}")


def _waiting(context: CheckContext, document: StatusDocument, name: str) -> Finding:
    """Return a finding on a waiting worker: a side waits for its network, and a module reports what it waits for."""
    if not isinstance(document, ModuleStatus):
        return warn(f"{name} waits: its network is unavailable", "see the checks of that side")
    note = _cause(context, document)
    return warn(f"{name} waits: {document.text if note is None else note.text}", "" if note is None else note.cure)


def _cause(context: CheckContext, document: StatusDocument) -> Note | None:
    """Return why a module waits or warns, if its descriptor names a function that finds that out."""
    module = all_modules().get(document.worker)
    note: Note | None = imported(module.cause)(context, document) if module is not None and module.cause else None
    return note


def check_port(context: CheckContext) -> Findings:
    """Check which program listens at the router's address: Midspan's router, another router, or something else."""
    hub = context.config.hub
    try:
        info = probe_router(hub.listen, hub.zenoh)
    except HubError as err:
        return fail(str(err), "correct hub.zenoh")
    if info is None:
        deaf = unresponsive_router(context.config)
        if deaf:
            return fail(deaf, "see the checks 'daemon' and 'descriptors'; if both are good, end that process")
        if not port_held(hub.listen):
            return ok(f"nothing listens at {hub.listen}: the daemon's router will")
        seen = f"{hub.listen} is held by a program that is not zenoh{_holder(hub.listen)}"
        return fail(seen, "stop that program, or set hub.listen to a free port")
    if info.mode != "router":
        return fail(f"{hub.listen} is held by {info}, which routes nothing", "set hub.listen to a free port")
    if info.daemon:
        return ok(f"{hub.listen} is {info}")
    text = f"{hub.listen} is held by {info}{_holder(hub.listen)}"
    if hub.router is True:
        return fail(text, "hub.router is true: stop that router, set hub.listen to a free port, or hub.router to auto")
    return warn(f"{text}; it is used as the hub's router", "if that is not intended, set hub.listen to a free port")


def _holder(endpoint: str) -> str:
    """Return the process that listens at an endpoint, "" if this user may not see it."""
    try:
        holder = port_holder(endpoint)
        return f" (process {holder.pid}, {holder.name()})" if holder is not None else ""
    except psutil.Error:
        return ""


SOON_DAYS = 30
_RENEW = "'midspan keys make NAME --replace', and copy the files; the router loads them without a restart"


def check_keys(context: CheckContext) -> Findings:
    """Check that the files of ``hub.open`` exist, are readable, fit each other and this machine, and stay valid."""
    if not has_tls(context.config.hub.open):
        return skip("hub.open names no endpoint with TLS: no certificate is needed")
    files = key_files(context.config)
    try:
        files.check()
        certificate, authority = read_certificate(files.certificate), read_certificate(files.ca)
        signed = signed_by(files.certificate, files.ca)
    except (HubConfigError, CertificateError) as err:
        return fail(str(err), "'midspan keys make' makes the files; see docs/operate/security.md")
    findings = [
        *_validity(certificate),
        *_validity(authority),
        *_fit(files),
        *_mode(files),
        *_distrust(certificate.name, context),
    ]
    if not signed:
        cure = "copy both from the same folder of 'midspan keys'"
        findings.append(fail(f"{files.certificate} was not signed by {files.ca}", cure))
    if certificate.name != context.config.name:
        findings.append(
            warn(f"this machine's certificate names it {certificate.name!r}: others trust that name", "see 'name'")
        )
    return findings or ok(f"this machine is {certificate.name} to others, until {certificate.until:%Y-%m-%d}")


def _distrust(name: str, context: CheckContext) -> list[Finding]:
    """Return a warning for each daemon that accepts no commands from this machine."""
    return [
        warn(
            f"{document.daemon} accepts no commands, goals or service calls from this machine",
            f"if that is not intended, name {name!r} in hub.open.trusted there",
        )
        for document in context.hub.documents
        if isinstance(document, RouterStatus)
        for machine in document.machines
        if machine.name == name and not machine.trusted
    ]


def _validity(certificate: Certificate) -> list[Finding]:
    """Return a finding if a certificate is not valid yet, has expired, or expires soon."""
    if certificate.begins_later():
        seen = f"{certificate.file} is not valid before {certificate.since:%Y-%m-%d %H:%M} UTC: no machine accepts it"
        return [fail(seen, early_cure())]
    left = certificate.days_left()
    if left < 0:
        return [fail(f"{certificate.file} expired on {certificate.until:%Y-%m-%d}: no machine accepts it", _RENEW)]
    if left < SOON_DAYS:
        return [warn(f"{certificate.file} expires in {left} days", _RENEW)]
    return []


def _fit(files: KeyFiles) -> list[Finding]:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    try:
        context.load_cert_chain(files.certificate, files.key, password="")
    except ssl.SSLError as err:
        mismatch = err.reason in ("KEY_VALUES_MISMATCH", "KEY_TYPE_MISMATCH")
        seen = f"is not the key of {files.certificate}" if mismatch else f"cannot be used: {err}"
        return [fail(f"{files.key} {seen}", "copy both from the same folder of 'midspan keys'")]
    return []


def _mode(files: KeyFiles) -> list[Finding]:
    if not files.others_may_use_key():
        return []
    return [warn(f"other users may use {files.key}, and so impersonate this machine", f"chmod 600 {files.key}")]
