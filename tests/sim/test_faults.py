"""Sensors that fail at a client's wish."""

from __future__ import annotations

import numpy as np
import pytest

from sim.errors import SimError
from tests.sim.floors import simulation, turn_wheels


def test_a_silent_laser_makes_no_scans_and_goes_on() -> None:
    sim = simulation(drive="wheels")
    sim.run(0.5)
    last = sim.scan.time_ns
    sim.faults.set("laser_silent", on=True)
    sim.run(0.5)
    assert sim.scan.time_ns == last
    sim.faults.set("laser_silent", on=False)
    sim.run(0.1)
    assert sim.scan.time_ns == sim.time_ns


def test_a_blind_laser_says_that_it_sees_nothing() -> None:
    sim = simulation(drive="wheels")
    sim.faults.set("laser_blind", on=True)
    sim.run(0.1)
    assert np.isnan(sim.scan.ranges).all()
    sim.faults.set("laser_blind", on=False)
    sim.run(0.1)
    assert np.isfinite(sim.scan.ranges).all()


def test_frozen_encoders_lose_the_way_and_go_on_from_where_they_were() -> None:
    sim = simulation(drive="wheels")
    turn_wheels(sim, 0.5, 3.0, 3.0)
    before = sim.estimate.pose.x
    sim.faults.set("encoders_frozen", on=True)
    turn_wheels(sim, 0.5, 3.0, 3.0)
    assert sim.estimate.pose.x == before
    assert not sim.motors.encoders().velocities.any()
    there = sim.base.pose().x
    assert there > before + 0.1
    sim.faults.set("encoders_frozen", on=False)
    turn_wheels(sim, 0.5, 3.0, 3.0)
    assert sim.estimate.pose.x - before == pytest.approx(sim.base.pose().x - there, abs=0.01)


def test_an_unknown_fault_is_refused_and_a_reset_mends_all() -> None:
    sim = simulation()
    with pytest.raises(SimError, match="there are laser_silent"):
        sim.faults.set("camera", on=True)
    sim.faults.set("laser_silent", on=True)
    assert list(sim.faults) == ["laser_silent"]
    sim.begin()
    assert not list(sim.faults)
