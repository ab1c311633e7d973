"""Injected sensor faults."""

from __future__ import annotations

import numpy as np
import pytest

from sim import environment
from sim.environment import SimError
from tests.peers.sim.floors import simulation, turn_wheels


def test_a_silent_laser_publishes_no_scans_until_the_fault_is_removed() -> None:
    simulated = simulation(drive="wheels")
    simulated.run(0.5)
    last = simulated.scan.time_ns
    simulated.faults.set("laser_silent", on=True)
    simulated.run(0.5)
    assert simulated.scan.time_ns == last
    simulated.faults.set("laser_silent", on=False)
    simulated.run(0.1)
    assert simulated.scan.time_ns == simulated.time_ns


def test_a_blind_laser_publishes_only_nan() -> None:
    simulated = simulation(drive="wheels")
    simulated.faults.set("laser_blind", on=True)
    simulated.run(0.1)
    assert np.isnan(simulated.scan.ranges).all()
    simulated.faults.set("laser_blind", on=False)
    simulated.run(0.1)
    assert np.isfinite(simulated.scan.ranges).all()


def test_frozen_encoders_miss_motion_and_continue_from_their_last_value() -> None:
    simulated = simulation(drive="wheels")
    turn_wheels(simulated, 0.5, 3.0, 3.0)
    before = simulated.estimate.pose.x
    simulated.faults.set("encoders_frozen", on=True)
    turn_wheels(simulated, 0.5, 3.0, 3.0)
    assert simulated.estimate.pose.x == before
    assert not simulated.wheels.motors.encoders().velocities.any()
    true_x = simulated.base.pose().x
    assert true_x > before + 0.1
    simulated.faults.set("encoders_frozen", on=False)
    turn_wheels(simulated, 0.5, 3.0, 3.0)
    assert simulated.estimate.pose.x - before == pytest.approx(simulated.base.pose().x - true_x, abs=0.01)


def test_unknown_faults_are_rejected_and_a_reset_removes_all() -> None:
    simulated = simulation()
    with pytest.raises(SimError, match="the faults are laser_silent"):
        simulated.faults.set("camera", on=True)
    simulated.faults.set("laser_silent", on=True)
    assert list(simulated.faults) == ["laser_silent"]
    simulated.begin()
    assert not list(simulated.faults)


def test_a_missing_opengl_library_is_reported_with_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_name: str) -> None:
        raise ImportError("libGL.so.1: cannot open shared object file")

    monkeypatch.setattr("sim.environment.missing", str)
    monkeypatch.setattr("importlib.import_module", refuse)
    with pytest.raises(SimError, match="apt install libgl1"):
        environment.dartpy.__wrapped__()


@pytest.mark.parametrize(
    ("system", "processor", "version", "cure"),
    [
        ("linux", "x86_64", (3, 13), "pip install 'midspan[sim]'"),
        ("linux", "aarch64", (3, 11), "pip install 'midspan[sim]'"),
        ("linux", "aarch64", (3, 14), "run 'midspan sim' on such a machine, joined to the same hub"),
        ("linux", "riscv64", (3, 11), "run 'midspan sim' on such a machine, joined to the same hub"),
        ("darwin", "arm64", (3, 11), "run 'midspan sim' on such a machine, joined to the same hub"),
    ],
)
def test_the_error_without_dart_names_the_remedy(
    system: str, processor: str, version: tuple[int, int], cure: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    monkeypatch.setattr("sys.platform", system)
    monkeypatch.setattr("platform.machine", lambda: processor)
    monkeypatch.setattr("sys.version_info", version)
    assert environment.missing().endswith(cure)
