"""Where a hub session's endpoints come from: the foreign network behind a Midspan worker."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Origin:
    """The foreign network that a worker's hub session speaks for.

    A hub session without an origin token is a native participant of the hub (an rmw_zenoh node, a zenoh program).

    Attributes:
        side: ``ros1``, ``ros2``, ``yarp``, or of the zenoh adapter's dialects ``zenoh_ros2dds``, ``zenoh_ros1``,
            ``zenoh_json``.
        network: identity of the network: the master's run id on ROS 1, the participant's marked GUID prefix (24 hex
            digits) on ROS 2, the dialect session's id on zenoh. The adapter of that side says whether it is its own
            network.
        daemon: identity of the daemon (its machine and name), for people.
    """

    side: str
    network: str
    daemon: str
