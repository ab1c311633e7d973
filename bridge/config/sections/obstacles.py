"""Sources of obstacles for several modules."""

from __future__ import annotations

from typing import Literal

from bridge.config.sections.section import (
    Section,
    TopicName,
    setting,
)


class ObstacleSection(Section):
    """An additional source of obstacles, for example a camera that sees the tops of tables."""

    topic: TopicName = setting(..., "The source's topic.")
    type: Literal["cloud", "layer"] = setting(
        "layer",
        "`cloud`: live points (`sensor_msgs/msg/PointCloud2`); `layer`: cells of the map that the robot would"
        " touch (`nav_msgs/msg/OccupancyGrid`, from 50 on), such as Mapper3D's.",
    )
    timeout: float | None = setting(
        None,
        "Seconds without a message after which the source counts as silent; empty: 0.5 (cloud), 5 (layer).",
        gt=0,
        le=3600,
    )

    def silent(self, last: float | None, now: float) -> str:
        """Return why the source counts as silent, else ""; ``last`` is the time of its last message, or None."""
        if last is None:
            return f"the {self.type} {self.topic} has not arrived yet"
        if now - last <= (self.timeout or {"cloud": 0.5, "layer": 5.0}[self.type]):
            return ""
        return f"the {self.type} {self.topic} is silent: no message for {now - last:.1f} s"
