"""Sensors that fail at a client's wish."""

from __future__ import annotations

import numpy as np
import pytest

from sim import environment
from sim.environment import SimError
from tests.sim.floors import simulation, turn_wheels


def test_a_silent_laser_makes_no_scans_and_goes_on() -> None:
    simulated = simulation(drive="wheels")
    simulated.run(0.5)
    last = simulated.scan.time_ns
    simulated.faults.set("laser_silent", on=True)
    simulated.run(0.5)
    assert simulated.scan.time_ns == last
    simulated.faults.set("laser_silent", on=False)
    simulated.run(0.1)
    assert simulated.scan.time_ns == simulated.time_ns


def test_a_blind_laser_says_that_it_sees_nothing() -> None:
    simulated = simulation(drive="wheels")
    simulated.faults.set("laser_blind", on=True)
    simulated.run(0.1)
    assert np.isnan(simulated.scan.ranges).all()
    simulated.faults.set("laser_blind", on=False)
    simulated.run(0.1)
    assert np.isfinite(simulated.scan.ranges).all()


def test_frozen_encoders_lose_the_way_and_go_on_from_where_they_were() -> None:
    simulated = simulation(drive="wheels")
    turn_wheels(simulated, 0.5, 3.0, 3.0)
    before = simulated.estimate.pose.x
    simulated.faults.set("encoders_frozen", on=True)
    turn_wheels(simulated, 0.5, 3.0, 3.0)
    assert simulated.estimate.pose.x == before
    assert not simulated.motors.encoders().velocities.any()
    there = simulated.base.pose().x
    assert there > before + 0.1
    simulated.faults.set("encoders_frozen", on=False)
    turn_wheels(simulated, 0.5, 3.0, 3.0)
    assert simulated.estimate.pose.x - before == pytest.approx(simulated.base.pose().x - there, abs=0.01)


def test_an_unknown_fault_is_refused_and_a_reset_mends_all() -> None:
    simulated = simulation()
    with pytest.raises(SimError, match="there are laser_silent"):
        simulated.faults.set("camera", on=True)
    simulated.faults.set("laser_silent", on=True)
    assert list(simulated.faults) == ["laser_silent"]
    simulated.begin()
    assert not list(simulated.faults)


def test_a_system_without_opengl_is_told_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_name: str) -> None:
        raise ImportError("libGL.so.1: cannot open shared object file")

    monkeypatch.setattr("sim.environment.missing", str)
    monkeypatch.setattr("importlib.import_module", refuse)
    with pytest.raises(SimError, match="apt install libgl1"):
        environment.dartpy.__wrapped__()
