"""Is another bridge on the same networks? Two that carry the same topics make each message come twice, or loop."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Sequence

from bridge.adapters.ros1.errors import Ros1Error
from bridge.adapters.ros1.presence import Ledger, Presence, is_alive
from bridge.adapters.ros2.environment import available
from bridge.config.state import state_folder
from bridge.doctor import dds
from bridge.doctor.around import Around
from bridge.doctor.checks.ros1 import why_not
from bridge.doctor.finding import Finding, fail, ok, skip, warn

FOREIGN = re.compile(r"(ros1?|ros_1|dynamic|static|parameter|simple)_bridge(_.*)?|ros1_to_ros2.*|.*zenoh_bridge.*")
"""Last part of the names of other bridges' nodes: ros1_bridge calls its nodes ``ros_bridge`` on both sides."""

_CURE_FOREIGN = "stop the other bridge, or deny in routing.rules what it carries"


def look(around: Around) -> Sequence[Finding]:
    """On the hub, on ROS 1, on ROS 2."""
    findings = [*_on_hub(around), *_on_ros1(around), *_on_ros2(around)]
    if any(finding.result in ("warn", "fail") for finding in findings):
        return [finding for finding in findings if finding.result != "ok"]
    return findings or [ok("no other bridge was seen")]


def _on_hub(around: Around) -> list[Finding]:
    daemons: dict[tuple[str, str], set[str]] = defaultdict(set)
    for document in around.hub.documents:
        if document.get("network") and document.get("state") != "standby":
            daemons[str(document.get("side")), str(document["network"])].add(str(document.get("daemon")))
    return [
        fail(
            f"the daemons {' and '.join(sorted(names))} are both active on the {side} network {network}",
            "turn that side off in one of them (enabled: false)",
        )
        for (side, network), names in sorted(daemons.items())
        if len(names) > 1
    ]


def _on_ros1(around: Around) -> list[Finding]:
    reason = why_not(around)
    if reason:
        return [skip(f"ROS 1: {reason}")]
    look = around.look_at_master()
    if isinstance(look, Ros1Error):
        return [skip("ROS 1: the master does not answer")]
    findings = _foreign("ROS 1", look.uris)
    entries = [entry for entry in map(Presence.parse, look.presence.values()) if entry is not None]
    for entry in entries:
        if _is_ours(around, entry):
            continue
        if is_alive("/midspan_doctor", entry):
            findings.append(
                warn(
                    f"ROS 1: Midspan daemon {entry.daemon} is on this master too ({entry.node} at {entry.uri})",
                    "if that is not meant, set ros1.enabled: false in one of them; one is active, the other stands by",
                )
            )
        else:
            findings.append(
                warn(
                    f"ROS 1: {entry.node} of Midspan daemon {entry.daemon} is dead, and still registered",
                    f"it goes when {entry.daemon} is started again; 'rosnode cleanup' removes its registrations",
                )
            )
    return findings or [ok("ROS 1: no other bridge")]


def _is_ours(around: Around, entry: Presence) -> bool:
    running = {(d.get("daemon"), d.get("pid")) for d in around.hub.of_side("ros1")}
    if entry.daemon == around.config.name and (entry.daemon, entry.pid) in running:
        return True
    return entry.owner == Ledger(state_folder(around.config, around.environ)).owner


def _on_ros2(around: Around) -> list[Finding]:
    if around.config.ros2.enabled is False or available(around.config):
        return [skip("ROS 2: not on this machine")]
    try:
        return of_dds(around, dds.look(around.config, around.environ))
    except dds.LookError as err:
        return [warn(f"ROS 2: the network could not be looked at: {err}")]


def of_dds(around: Around, view: dds.DdsView) -> list[Finding]:
    """What is to be said of a ROS 2 network."""
    findings = _foreign("ROS 2", view.nodes)
    ours = {str(d.get("network")) for d in around.hub.of_side("ros2", around.config.name)}
    others = view.midspans - ours
    if others:
        mine = "besides this daemon's " if view.midspans & ours else ""
        findings.append(
            warn(
                f"ROS 2: {mine}{len(others)} Midspan participant(s) on this domain: {', '.join(sorted(others))}",
                "if that is not meant, give the daemons different ros2.domain, or turn one's ROS 2 side off",
            )
        )
    return findings or [ok("ROS 2: no other bridge")]


def _foreign(side: str, nodes: Iterable[str]) -> list[Finding]:
    names = sorted(node for node in nodes if FOREIGN.fullmatch(node.rsplit("/", 1)[-1]))
    if not names:
        return []
    return [
        fail(f"{side}: {', '.join(names)} looks like another bridge: topics that both carry come twice", _CURE_FOREIGN)
    ]
