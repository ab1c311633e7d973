"""The section ``clock``: the time scale."""

from __future__ import annotations

from typing import Literal

from bridge.config.sections.section import (
    Section,
    setting,
)


class ClockSection(Section):
    """The time scale of all stamps that Midspan makes."""

    source: Literal["system", "sim"] = setting(
        "system", "`system`: the machine's clock; `sim`: the topic `/clock`, and ROS 1's master gets `/use_sim_time`."
    )

    @property
    def simulated(self) -> bool:
        """Whether the time is that of ``/clock``."""
        return self.source == "sim"
