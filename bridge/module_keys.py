"""The keys of modules' and workers' status documents that other programs read, beyond the fields of `bridge.status`.

A program reads them with `bridge.status.Part.other`.
"""

from __future__ import annotations

from pydantic import Field

from bridge.status import Int, Number, Part, Text


class GatewayKeys(Part):
    """The gateway's own keys.

    Attributes:
        pending: the planner that takes over when the robot stands still.
        navigation: the navigation state that it publishes, with its ``reason``.
        goals: number of poses left. ``goal``: the next pose, as x and y in m, and the angle.
        goals_ended: number of goals by outcome.
        served_by: the node that serves the gateway's action instead.
        inactive_nodes: the states of the planner's lifecycle nodes that are not active, by node.
    """

    planner: Text = ""
    planners: list[Text] = Field(default=[])
    pending: Text = ""
    navigation: Text = ""
    reason: Text = ""
    goals: Int = 0
    goal: list[Number] | None = None
    client: Text = ""
    goals_of_others: Int = 0
    goals_ended: dict[Text, Int] | None = None
    served_by: Text = ""
    inactive_nodes: dict[Text, Text] = Field(default={})


class MapServerKeys(Part):
    """Map2DServer's own keys.

    Attributes:
        current: the current map. ``maps``, ``maps3d``: the topic of each map.
        taken: number of maps accepted from each topic. ``refusals``: number of refused maps.
    """

    current: Text = ""
    maps: dict[Text, Text] = Field(default={})
    maps3d: dict[Text, Text] = Field(default={})
    taken: dict[Text, Int] = Field(default={})
    refusals: Int = 0
    last_refusal: Text = ""


class StoreContent(Part):
    """What the store reports about its replica.

    Attributes:
        keys: number of values by kind.
        limits: maximum number of values of all kinds together (``keys``), and maximum size (``bytes``).
        changed: time of the newest change in any replica, in seconds since 1970.
        lost: the last values that lost a conflict.
        others: the stores that share the values.
    """

    keys: dict[Text, Int] = Field(default={})
    deleted: Int | None = None
    bytes: Int | None = None
    limits: dict[Text, Int] = Field(default={})
    changed: Number | None = None
    conflicts: Int | None = None
    lost: list[Text] = Field(default=[])
    others: list[Text] | None = None
    refused: Int | None = None


class StoreKeys(Part):
    """The store's own keys."""

    store: StoreContent = StoreContent()


class BoardStatus(Part):
    """A control board of a YARP robot; ``trouble`` is why it is not connected."""

    board: Text = ""
    joints: list[Text] = Field(default=[])
    trouble: Text = ""
    states: Int | None = None
    dropped_commands: Int | None = None


class BoardKeys(Part):
    """The own keys of the control boards' module; ``refused``: number of refused commands by reason."""

    boards: list[BoardStatus] = Field(default=[])
    refused: dict[Text, Text] = Field(default={})


class SharedParameters(Part):
    """A rule of ``routing.parameters``.

    Attributes:
        shared: number of shared parameters.
        skipped: the node's parameters that are not shared because their names are not valid in ROS 1, sorted.
    """

    ros1: Text = ""
    node: Text = ""
    owner: Text = ""
    shared: Int = 0
    skipped: list[Text] = Field(default=[])


class ParameterKeys(Part):
    """The key of the ROS 1 side's worker for its rules."""

    parameters: list[SharedParameters] = Field(default=[])
