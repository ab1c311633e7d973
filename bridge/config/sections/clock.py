"""The section ``clock``: the time scale of this run."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from bridge.config.sections.section import Section


class ClockSection(Section):
    """The time scale of all stamps that Midspan makes."""

    source: Literal["system", "sim"] = Field(
        default="system",
        description="`system`: the machine's clock; `sim`: what the topic `/clock` says, from whichever side. With"
        " `sim`, `/use_sim_time` is set on the ROS 1 master.",
    )

    @property
    def simulated(self) -> bool:
        """Whether the time is that of ``/clock``."""
        return self.source == "sim"
