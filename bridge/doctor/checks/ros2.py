"""ROS 2: are its packages here, and does this shell use the same domain and middleware as the daemon?"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bridge.adapters.ros2.environment import available, domain
from bridge.doctor.around import Around, environment_of
from bridge.doctor.finding import Finding, fail, ok, skip, warn

_KNOWN_RMW = ("rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp", "rmw_cyclonedds_cpp", "rmw_connextdds", "rmw_zenoh_cpp")


def look_at_packages(around: Around) -> Sequence[Finding]:
    """Is rclpy installed?"""
    enabled = around.config.ros2.enabled
    if enabled is False:
        return [skip("ros2.enabled is false")]
    reason = available(around.config)
    if not reason:
        return [ok("rclpy is installed")]
    if enabled is True:
        return [fail(f"ros2.enabled is true, but {reason}")]
    return [warn(f"the ROS 2 side stays off: {reason}", "nothing to do where no ROS 2 is wanted: ros2.enabled: false")]


def look_at_environment(around: Around) -> Sequence[Finding]:
    """Are this shell's programs in the daemon's domain, and do they look as far?"""
    if around.config.ros2.enabled is False:
        return [skip("ros2.enabled is false")]
    text = around.environ.get("ROS_DOMAIN_ID") or "0"
    if not (text.isascii() and text.isdigit() and int(text) <= 232):
        return [fail(f"ROS_DOMAIN_ID is {text!r}, not a number from 0 to 232", "export ROS_DOMAIN_ID=0, or unset it")]
    findings: list[Finding] = []
    meant, by = _daemons_domain(around)
    if int(text) != meant:
        findings.append(
            warn(
                f"this shell's ROS_DOMAIN_ID is {text}, {by} uses {meant}: its ROS 2 programs do not hear the daemon",
                f"export ROS_DOMAIN_ID={meant}, or set ros2.domain to {text}",
            )
        )
    findings += _range(around)
    profile = around.environ.get("FASTRTPS_DEFAULT_PROFILES_FILE") or around.environ.get(
        "FASTDDS_DEFAULT_PROFILES_FILE"
    )
    if profile and not Path(profile).is_file():
        findings.append(warn(f"the Fast DDS profile {profile} of this shell does not exist", "unset the variable"))
    return findings or [ok(f"domain {meant}")]


def look_at_rmw(around: Around) -> Sequence[Finding]:
    """Do this shell's ROS 2 programs speak DDS, as the ROS 2 side does?"""
    name = around.environ.get("RMW_IMPLEMENTATION", "")
    if not name or name.startswith("rmw_fastrtps"):
        return [ok(f"RMW_IMPLEMENTATION is {name or 'not set (Fast DDS)'}")]
    if name == "rmw_zenoh_cpp":
        cure = "nothing to do if that is meant; else unset RMW_IMPLEMENTATION"
        return [
            warn("RMW_IMPLEMENTATION is rmw_zenoh_cpp: this shell's programs are on the hub itself, not on DDS", cure)
        ]
    if name in _KNOWN_RMW:
        cure = "nothing to do for topics; Fast DDS (rmw_fastrtps_cpp) on both ends is what is tested"
        return [warn(f"RMW_IMPLEMENTATION is {name}: other DDS than Midspan's; large messages go over UDP", cure)]
    return [fail(f"RMW_IMPLEMENTATION is {name}, which is no middleware of ROS 2's", "unset it")]


def _daemons_domain(around: Around) -> tuple[int, str]:
    """The running worker's domain where it can be read, else the configuration's."""
    for document in around.hub.of_side("ros2", around.config.name):
        running = environment_of(around.process(document)).get("ROS_DOMAIN_ID", "")
        if running.isdigit():
            return int(running), "the running daemon"
    if around.config.ros2.domain is not None:
        return around.config.ros2.domain, "the configuration (ros2.domain)"
    return domain(around.config, around.environ), "the daemon"


def _range(around: Around) -> list[Finding]:
    """Programs that look on this machine alone do not hear another machine's, and the other way round."""
    environ, local = around.environ, around.config.ros2.localhost_only
    reach = environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    if reach == "OFF":
        return [fail("ROS_AUTOMATIC_DISCOVERY_RANGE is OFF: this shell's ROS 2 programs find nobody", "unset it")]
    shell_local = environ.get("ROS_LOCALHOST_ONLY") == "1" or reach == "LOCALHOST"
    if shell_local and not local:
        cure = "unset ROS_LOCALHOST_ONLY and ROS_AUTOMATIC_DISCOVERY_RANGE, or set ros2.localhost_only: true"
        return [warn("this shell's ROS 2 programs look on this machine only, ros2.localhost_only is false", cure)]
    return []
