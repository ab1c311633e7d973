"""Small floors and drives for tests."""

from __future__ import annotations

from typing import Any

from sim.base import Twist
from sim.plan import Floor, Plan
from sim.section import SimSection
from sim.simulation import Simulation

ROOM = (((-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0), (-2.0, -2.0)),)
"""Walls of a room of 4 m by 4 m."""

INSIDE = 1.95
"""Distance from the room's middle to its walls, meters."""


def simulation(*, floor: dict[str, Any] | None = None, **section: Any) -> Simulation:
    """Return a simulation in the room, with additions from ``floor``."""
    plan = Plan(name="room", floors={"room": Floor(**{"walls": ROOM, **(floor or {})})})
    return Simulation(SimSection(**section), plan)


def drive(simulation: Simulation, seconds: float, x: float, yaw: float = 0.0, y: float = 0.0) -> None:
    """Drive with a velocity command every 0.1 s."""
    for _ in range(round(seconds * 10)):
        simulation.command(Twist(x, y, yaw))
        simulation.run(0.1)


def turn_wheels(simulation: Simulation, seconds: float, *velocities: float) -> None:
    """Drive with a wheel command every 50 ms."""
    for _ in range(round(seconds * 20)):
        simulation.wheels.motors.drive(velocities)
        simulation.run(0.05)
