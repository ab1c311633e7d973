"""The two dialects of YARP's wire format.

YARP 4.0 renumbered the floating-point types of Bottles and added the 64-bit vocab; the rest is unchanged. A reader of
the wrong dialect fails or, worse, silently reads other numbers. Measured on YARP 3.9.1, 3.12.3 and 4.0
(`yarp/os/Bottle.h`).
"""

from __future__ import annotations

from enum import Enum


class Profile(Enum):
    """A dialect: YARP 3.4 to 3.12, which most robots run, or YARP 4.0 and later."""

    YARP3 = "yarp3"
    YARP4 = "yarp4"

    @property
    def float32_tag(self) -> int:
        """The tag of a 4-byte float."""
        return 128 if self is Profile.YARP3 else 10

    @property
    def float64_tag(self) -> int:
        """The tag of an 8-byte float."""
        return 10 if self is Profile.YARP3 else 20

    @property
    def vocab64_tag(self) -> int | None:
        """The tag of an 8-byte vocab; None for YARP 3, which lacks it."""
        return None if self is Profile.YARP3 else 18
