"""Other bridges on the same networks: two that carry the same topics duplicate messages, or create loops."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from bridge.adapters.ros1.graph.presence import Ledger, NodeEntry, is_alive
from bridge.adapters.ros1_peers import Ros1Error
from bridge.adapters.ros2.environment import available
from bridge.config.model import Config
from bridge.daemon.workers import worker_kinds
from bridge.doctor.check import Finding, Findings, fail, ok, skip, warn
from bridge.doctor.checks.ros1 import why_not
from bridge.doctor.context import CheckContext
from bridge.state_file import state_folder
from bridge.status import WorkerStatus

FOREIGN = re.compile(r"(ros1?|ros_1|dynamic|static|parameter|simple)_bridge(_.*)?|ros1_to_ros2.*|.*zenoh_bridge.*")
"""The last part of a node name of another bridge; ros1_bridge names its nodes ``ros_bridge`` on both sides."""

_CURE_FOREIGN = "stop the other bridge, or deny its topics in routing.rules"


def check(context: CheckContext) -> Findings:
    """Check the hub, ROS 1 and ROS 2 for other bridges."""
    findings = [*_on_hub(context), *_on_ros1(context), *_on_ros2(context)]
    if any(finding.result in ("warn", "fail") for finding in findings):
        return [finding for finding in findings if finding.result != "ok"]
    return findings or ok("no other bridge was seen")


def _on_hub(context: CheckContext) -> list[Finding]:
    daemons: dict[tuple[str, str], set[str]] = defaultdict(set)
    for document in context.hub.documents:
        if isinstance(document, WorkerStatus) and document.network and document.state != "standby":
            daemons[str(document.side), document.network].add(document.daemon)
    return [
        fail(
            f"the daemons {' and '.join(sorted(names))} are both active on the {side} network {network}",
            "turn that side off in one of them (enabled: false)",
        )
        for (side, network), names in sorted(daemons.items())
        if len(names) > 1
    ]


def _on_ros1(context: CheckContext) -> list[Finding]:
    if reason := why_not(context):
        return [skip(f"ROS 1: {reason}")]
    state = context.master_state()
    if isinstance(state, Ros1Error):
        return [skip("ROS 1: the master does not answer")]
    findings = _foreign("ROS 1", state.uris)
    entries = [entry for entry in map(NodeEntry.parse, state.presence.values()) if entry is not None]
    for entry in entries:
        if _is_ours(context, entry):
            continue
        if is_alive("/midspan_doctor", entry):
            seen = f"ROS 1: Midspan daemon {entry.daemon} is on this master too ({entry.node} at {entry.uri})"
            cure = "one daemon is active, the other on standby; if unintended, set ros1.enabled: false in one of them"
        else:
            seen = f"ROS 1: {entry.node} of Midspan daemon {entry.daemon} is dead, but still registered"
            cure = f"it disappears when {entry.daemon} is restarted; 'rosnode cleanup' removes its registrations"
        findings.append(warn(seen, cure))
    return findings or [ok("ROS 1: no other bridge")]


def _is_ours(context: CheckContext, entry: NodeEntry) -> bool:
    running = {(worker.daemon, worker.pid) for worker in context.hub.of_side("ros1")}
    if entry.daemon == context.config.name and (entry.daemon, entry.pid) in running:
        return True
    return entry.owner == Ledger(state_folder(context.config, context.environ)).owner


def _on_ros2(context: CheckContext) -> list[Finding]:
    if context.config.ros2.enabled is False or available(context.config):
        return [skip("ROS 2: not on this machine")]
    try:
        return of_dds(context, check_dds(context.config, context.environ))
    except NetworkCheckError as err:
        return [warn(f"ROS 2: the network could not be checked: {err}")]


def of_dds(context: CheckContext, view: DdsView) -> list[Finding]:
    """Return the findings on a ROS 2 network."""
    findings = _foreign("ROS 2", view.nodes)
    ours = {str(worker.network) for worker in context.hub.of_side("ros2", context.config.name)}
    others = view.midspans - ours
    if others:
        mine = "in addition to this daemon's " if view.midspans & ours else ""
        seen = f"ROS 2: {mine}{len(others)} Midspan participant(s) on this domain: {', '.join(sorted(others))}"
        cure = "if unintended, give each daemon its own ros2.domain, or disable the ROS 2 side of one of them"
        findings.append(warn(seen, cure))
    return findings or [ok("ROS 2: no other bridge")]


def _foreign(side: str, nodes: Iterable[str]) -> list[Finding]:
    names = sorted(node for node in nodes if FOREIGN.fullmatch(node.rsplit("/", 1)[-1]))
    if not names:
        return []
    seen = f"{side}: {', '.join(names)} looks like another bridge; topics that both bridge arrive twice"
    return [fail(seen, _CURE_FOREIGN)]


_SECONDS = 30.0
"""Time limit for the process that checks; it only detects a hang."""


class NetworkCheckError(Exception):
    """The ROS 2 network could not be checked."""


@dataclass(frozen=True, slots=True)
class DdsView:
    """The ROS 2 network: GUID prefixes (hex) of all Midspan participants but the doctor's, and nodes with endpoints."""

    midspans: frozenset[str]
    nodes: frozenset[str]


def check_dds(config: Config, environ: Mapping[str, str]) -> DdsView:
    """Join the network briefly; raises `NetworkCheckError`."""
    if reason := available(config):
        raise NetworkCheckError(reason)
    env = worker_kinds({})["ros2"].child_environment(config, environ)
    command = [sys.executable, "-m", "bridge.adapters.ros2.graph.reading"]
    try:
        done = subprocess.run(
            command, input=config.model_dump_json(by_alias=True), env=env, capture_output=True, encoding="utf-8",
            timeout=_SECONDS, check=False,
        )  # fmt: skip
        document = json.loads(done.stdout.splitlines()[-1])
        return DdsView(frozenset(map(str, document["midspans"])), frozenset(map(str, document["nodes"])))
    except subprocess.TimeoutExpired:
        raise NetworkCheckError(f"no response within {_SECONDS:g} s") from None
    except (IndexError, KeyError, TypeError, ValueError):
        last = done.stderr.strip().splitlines()[-1:] or ["it printed nothing"]
        raise NetworkCheckError(last[0]) from None
