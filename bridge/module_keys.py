"""The keys of modules' status documents that other programs read, beyond those of a `bridge.status.ModuleStatus`.

A program reads them with `bridge.status.Part.other`.
"""

from __future__ import annotations

from typing import Any

from pydantic import Field

from bridge.status import Int, Number, Part, Text


class GatewayKeys(Part):
    """The gateway's own keys.

    Attributes:
        navigation: the state that it publishes.
        inactive_nodes: the states of the planner's lifecycle nodes that are not active, by node.
    """

    planner: Text = ""
    navigation: Text = ""
    pending: Text = ""
    goals: Int = 0
    goal: Any = None
    client: Text = ""
    goals_of_others: Int = 0
    goals_ended: dict[Text, Int] | None = None
    served_by: Text = ""
    inactive_nodes: dict[Text, Text] = Field(default={})


class MapServerKeys(Part):
    """Map2DServer's own keys; ``taken``: number of maps accepted from each topic."""

    taken: dict[Text, Int] = Field(default={})


class StoreContent(Part):
    """What the store reports about its replica.

    Attributes:
        keys: number of values by kind.
        limits: the most values of all kinds together (``keys``), and the most bytes (``bytes``).
        others: the stores that share the values.
    """

    keys: dict[Text, Int] = Field(default={})
    bytes: Int | None = None
    limits: dict[Text, Int] = Field(default={})
    deleted: Int | None = None
    conflicts: Int | None = None
    refused: Int | None = None
    changed: Number | None = None
    others: list[Text] | None = None


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
    """The own keys of the control boards' module."""

    boards: list[BoardStatus] = Field(default=[])
