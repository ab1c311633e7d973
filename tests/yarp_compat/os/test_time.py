"""Time, on the system's clock."""

from __future__ import annotations

import time

import pytest

import yarp_compat as yarp


def test_now_is_the_time_since_1970() -> None:
    assert abs(yarp.now() - time.time()) < 1
    assert abs(yarp.Time.now() - time.time()) < 1


def test_delay_waits() -> None:
    begin = time.monotonic()
    yarp.delay(0.02)
    yarp.Time.delay(-1)
    assert time.monotonic() - begin >= 0.02


def test_a_network_clock_is_refused() -> None:
    with pytest.raises(NotImplementedError, match="/clock"):
        yarp.Time.useNetworkClock("/clock")
    assert yarp.Time.isSystemClock()
    assert yarp.Time.clockTypeToString(yarp.Time.getClockType()) == "YARP_CLOCK_SYSTEM"
