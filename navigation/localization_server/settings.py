"""How the localiser works; what is written here holds for R1 and its like."""

from __future__ import annotations

from dataclasses import dataclass

from navigation.algorithms.particle_filter import Alphas


@dataclass(frozen=True)
class Settings:
    """Of the localiser.

    Attributes:
        particles: how many.
        beams: of a scan that are used, at most.
        holonomic: whether the base can go sideways.
        alphas: how far odometry may be off, see `navigation.algorithms.particle_filter.Alphas`.
        sigma: standard deviation of a beam's end from its wall, metres.
        hit: share of beams that end at what the map has.
        independent: as how many independent measurements a scan counts, since neighbouring beams err together.
        update_distance: metres after which a scan is taken up.
        update_angle: radians after which one is.
        initial_spread: standard deviations that a start without a covariance has: metres, radians.
        explained_within: metres from a wall within which the map explains a beam's end.
        good: share of beams explained, less those that speak against it, from which on the robot is localised.
        poor: share below which it is lost.
        refuting: share of beams that go through walls from which on a scan speaks against the pose.
        refuting_scans: so many such scans in a row and the robot is lost.
        sure: share from which on nobody looks for better places.
        better: how much larger another place's share must be.
        search_every: seconds between looks for better places, at least.
        lost_search_every: the same of a robot that is lost.
        search_reach: metres around the estimate in which they are looked for.
        search_turn: radians to each side.
        lost_reach: metres in which, and in all directions, they are looked for by a robot that is lost.
        widest: metres that the particles' spread (standard deviation) may have where the robot is localised.
        scan_age: seconds after which a laser counts as silent.
        odometry_age: seconds after which odometry does.
    """

    particles: int = 1000
    beams: int = 360
    holonomic: bool = False
    alphas: Alphas = (0.1, 0.1, 0.1, 0.1, 0.1)
    sigma: float = 0.08
    hit: float = 0.9
    independent: float = 30.0
    update_distance: float = 0.1
    update_angle: float = 0.1
    initial_spread: tuple[float, float] = (0.5, 0.26)
    explained_within: float = 0.15
    good: float = 0.6
    poor: float = 0.4
    refuting: float = 0.15
    refuting_scans: int = 3
    sure: float = 0.9
    better: float = 0.1
    search_every: float = 3.0
    lost_search_every: float = 1.0
    search_reach: float = 4.0
    search_turn: float = 0.79
    lost_reach: float = 12.0
    widest: float = 0.5
    scan_age: float = 1.0
    odometry_age: float = 1.0
