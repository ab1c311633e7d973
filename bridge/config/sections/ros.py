"""The sections ``ros1`` and ``ros2``."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

from pydantic import field_validator, model_validator
from typing_extensions import override

from bridge.config.sections.listen import split
from bridge.config.sections.section import (
    EMBEDDED,
    Address,
    Enabled,
    MasterUri,
    Mistake,
    NodeName,
    SideSection,
    setting,
)
from bridge.registration import imported

_PROFILE_CHECK = "bridge.adapters.ros2.profile_file:mistake"
_ANY = ("0.0.0.0", "::")  # noqa: S104  only compared, never bound


class Ros1Section(SideSection):
    """The ROS 1 side."""

    enabled: Enabled = setting("auto", "`auto` and `true` enable the side, which waits until a master runs.")
    master: MasterUri | None = setting(
        None,
        "ROS master URI; default $ROS_MASTER_URI or http://localhost:11311. `embedded`: Midspan runs a master itself;"
        " see [ROS 1 master](../sides/ros1_master.md).",
    )
    listen: str = setting("127.0.0.1:11311", "Address and port of the embedded master.")
    purge: float = setting(
        30.0,
        "Embedded master: seconds until it removes a node whose address refuses connections; 0: never.",
        ge=0,
        le=86400,
    )
    ip: Address | None = setting(None, "Address that this machine gives to ROS 1 peers (ROS_IP).")
    hostname: Address | None = setting(None, "Host name that this machine gives to ROS 1 peers (ROS_HOSTNAME).")
    node: NodeName = setting("midspan", "Node name on the ROS 1 graph.")
    poll: float = setting(
        0.5, "Seconds between two polls of the master; up to 2 with hundreds of topics.", ge=0.05, le=10
    )
    goal_frames: Literal["check", "pass"] = setting(
        "check",
        "Frames of action goals. `check` removes leading slashes, and rejects goals whose frame occurs in no transform"
        " of this side (move_base would keep such a goal active for ever); `pass` leaves them unchanged.",
    )
    packages: Path | None = setting(
        None, "Folder with ROS 1's Python packages, for their message definitions; default: this system's packages."
    )

    @override
    def named_files(self) -> Iterator[Path]:
        if self.packages is not None:
            for pattern in ("*/msg/_*.py", "*/srv/_*.py"):
                yield from sorted(self.packages.glob(pattern))

    @property
    def embedded_uri(self) -> str:
        """URI of the embedded master, "" if `master` is not `embedded`.

        Its host is `hostname`, else `ip`, else the address of `listen`, or the machine's name if that is a wildcard.
        """
        if self.master != EMBEDDED:
            return ""
        address, port = split(self.listen)
        host = self.hostname or self.ip or (socket.gethostname() if address in _ANY else address)
        return f"http://{f'[{host}]' if ':' in host else host}:{port}/"

    @field_validator("listen")
    @classmethod
    def _is_an_address(cls, value: str) -> str:
        _, port = split(value)
        if port == 0:
            msg = f"{value!r} has no fixed port, which ROS 1 nodes must know; write for example 127.0.0.1:11311"
            raise ValueError(msg)
        return value


class Ros2Section(SideSection):
    """The ROS 2 (DDS) side."""

    enabled: Enabled = setting("auto", "`auto`: if rclpy is installed.")
    domain: int | None = setting(None, "ROS_DOMAIN_ID; default: that of the environment, else 0.", ge=0, le=232)
    node: NodeName = setting("midspan", "Node name on the ROS 2 graph.")
    transport: Literal["auto", "shared_memory", "udp"] = setting(
        "auto",
        "Fast DDS transports. `auto`: shared memory and UDP; only UDP if /dev/shm is too small, or other users run"
        " ROS 2 nodes here (shared memory delivers nothing between users).",
    )
    rmw: Literal["rmw_fastrtps_cpp", "rmw_cyclonedds_cpp"] = setting(
        "rmw_fastrtps_cpp",
        "Middleware of the worker itself. `rmw_cyclonedds_cpp`: Cyclone DDS, from a sourced ROS 2; services and actions"
        " are bridged only to nodes that use it too, see [ROS 2](../sides/ros2.md#midspan-on-cyclone-dds).",
    )
    profile: Path | None = setting(None, "Your own Fast DDS XML profile, used instead of the generated one.")
    localhost_only: bool = setting(True, "Discover ROS 2 nodes of this machine only.")

    @override
    def mistakes(self, config: Any) -> Iterator[Mistake]:
        if self.profile is not None and (reason := imported(_PROFILE_CHECK)(self.profile)):
            yield ("profile",), reason

    @model_validator(mode="after")
    def _fits_the_middleware(self) -> Ros2Section:
        if self.rmw == "rmw_cyclonedds_cpp":
            if self.profile is not None:
                raise ValueError("ros2.profile is for Fast DDS; set CYCLONEDDS_URI for the daemon, or remove ros2.rmw")
            if self.transport == "shared_memory":
                raise ValueError(
                    "ros2.transport shared_memory is for Fast DDS, and Cyclone DDS uses UDP; remove ros2.transport or"
                    " ros2.rmw"
                )
        return self
