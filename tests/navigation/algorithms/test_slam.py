"""Maps from drifting odometry: loops are closed, wrong closures are refused, and a loaded map is recognized."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from navigation.algorithms.loops import LoopResult, search_surfels
from navigation.algorithms.pose_graph import PoseGraph
from navigation.algorithms.slam import Search, Slam
from navigation.algorithms.surfels import Surfels
from navigation.pose import Pose
from tests.navigation.algorithms.scanned import Laser, Seen, corridor, drive

AROUND = 30.0


def off(pose: Pose, truth: Pose) -> tuple[float, float]:
    """Return the distance in meters and the angle in degrees between two poses."""
    return pose.distance(truth), abs(math.degrees(math.remainder(pose.theta - truth.theta, math.tau)))


@pytest.fixture(scope="module")
def driven() -> list[Seen]:
    return list(drive(Laser(corridor()), AROUND))


@pytest.fixture(scope="module")
def mapped(driven: list[Seen]) -> Slam:
    slam = Slam(driven[0].truth)
    for seen in driven:
        slam.add(seen.odometry, seen.scan)
    return slam


def test_the_map_is_right_despite_drifting_odometry(driven: list[Seen], mapped: Slam) -> None:
    first, last = driven[0], driven[-1]
    meters, degrees = off(first.truth @ (first.odometry.inverse @ last.odometry), last.truth)
    assert meters > 1.0
    assert degrees > 20.0
    meters, degrees = off(mapped.pose, last.truth)
    assert meters < 0.03
    assert degrees < 0.5
    assert mapped.loops.closed > 0
    submaps = mapped.submaps
    middles = [min(off(submaps.on_map(view), seen.truth)[0] for seen in driven) for view in submaps.views]
    assert max(middles) < 0.06


class Later:
    """Runs searches when they are submitted, and delivers their results later, as a slow thread does."""

    def __init__(self) -> None:
        self.found: LoopResult | None = None
        self._deliver: Callable[[LoopResult | None], object] | None = None

    def run(self, prepare: Callable[[], Search], deliver: Callable[[LoopResult | None], object]) -> None:
        if self._deliver is None:
            self.found, self._deliver = prepare()(), deliver

    def deliver(self) -> None:
        """Deliver the result, if a search was submitted."""
        found, self.found = self.found, None
        action, self._deliver = self._deliver, None
        if action is not None:
            action(found)


def test_the_map_is_right_if_loops_are_found_late() -> None:
    driven, later = list(drive(Laser(corridor()), 42.0)), Later()
    slam = Slam(driven[0].truth, later.run)
    moved = 0.0
    for seen in driven:
        slam.add(seen.odometry, seen.scan)
        before, found = list(slam.submaps.graph.poses), later.found
        known = len(before) - 1 if found is None or found.poses is None else len(found.poses) - 1
        if found is not None and found.poses is not None and known == len(before) - 1:
            continue  # wait for a submap that the search does not know
        later.deliver()
        poses = slam.submaps.graph.poses
        moved = max(moved, before[known].distance(poses[known]))
        # the newer submaps move with the last one known to the search
        assert poses[known].inverse @ poses[-1] == pytest.approx(before[known].inverse @ before[-1])
    meters, degrees = off(slam.pose, driven[-1].truth)
    assert moved > 0.005, "no search moved the submaps"
    assert meters < 0.05
    assert degrees < 0.7


def test_a_search_that_began_before_the_map_was_moved_has_no_effect(driven: list[Seen]) -> None:
    later = Later()
    slam = Slam(driven[0].truth, later.run)
    moved = Pose(5.0, 1.0, 0.5)
    for seen in driven:
        slam.add(seen.odometry, seen.scan)
        if later.found is not None:
            break
        later.deliver()
    assert later.found is not None
    slam.move(moved, (0.0, 0.0))
    poses, edges = list(slam.submaps.graph.poses), len(slam.submaps.graph.edges)
    later.deliver()
    assert slam.submaps.graph.poses == poses
    assert len(slam.submaps.graph.edges) == edges
    assert slam.pose == pytest.approx(moved)


def test_a_scan_is_matched_to_a_millimeter(driven: list[Seen]) -> None:
    surfels = Surfels(12.0)
    for seen in driven[:10]:
        surfels.add(seen.scan.surface().moved(seen.truth))
    truth = driven[10].truth
    match = surfels.match(driven[10].scan.surface(), truth @ Pose(0.08, -0.06, 0.05))
    meters, degrees = off(match.pose, truth)
    assert meters < 0.005
    assert degrees < 0.1
    assert match.share > 0.8


def test_a_scan_is_found_far_from_its_guess(driven: list[Seen]) -> None:
    surfels = Surfels(12.0)
    for seen in driven[:25]:
        surfels.add(seen.scan.surface().moved(seen.truth))
    truth = driven[12].truth
    match = search_surfels(surfels, driven[12].scan.surface(), truth @ Pose(1.5, 0.6, 0.5), 2.5, 0.7)
    assert match is not None
    assert off(match.pose, truth)[0] < 0.02


def test_a_loaded_map_is_continued_from_a_rough_pose(driven: list[Seen], mapped: Slam) -> None:
    count = len(mapped.submaps.views)
    again = Slam.resume(mapped.submaps, driven[40].truth @ Pose(0.4, -0.3, 0.2), (1.0, 0.5))
    assert again.correction is None
    offset = Pose(5.0, 1.0, 2.0)  # the odometry was reset
    for seen in driven[40:80]:
        again.add(offset @ seen.odometry, seen.scan)
    assert again.correction is not None
    assert off(again.pose, driven[79].truth)[0] < 0.05
    assert len(again.submaps.views) > count


def test_a_reset_of_the_odometry_does_not_move_the_robot(driven: list[Seen]) -> None:
    slam = Slam(driven[0].truth)
    for seen in driven[:20]:
        slam.add(seen.odometry, seen.scan)
    moved = Pose(-40.0, 3.0, 1.0)
    for seen in driven[20:30]:
        slam.add(moved @ seen.odometry, seen.scan)
    assert off(slam.pose, driven[29].truth)[0] < 0.03


def square(*, wrong: bool) -> PoseGraph:
    """Return the graph of a square with drifting steps, closed by correct measurements and maybe a wrong one."""
    graph, sure = PoseGraph(), np.diag((1e4, 1e4, 1e5))
    graph.add(Pose(0.0, 0.0, 0.0))
    for number in range(8):
        step = Pose(1.0, 0.0, math.radians(45.0) + 0.01)
        graph.add(graph.poses[-1] @ step)
        graph.join(number, number + 1, step, np.diag((1e4, 1e4, 1e3)))
    graph.join(0, 8, Pose(0.0, 0.0, 0.0), sure, loop=True)
    graph.join(1, 8, Pose(1.0, 0.0, math.radians(45.0)).inverse, sure, loop=True)
    if wrong:
        graph.join(2, 6, Pose(0.0, 0.0, 0.0), sure, loop=True)
    return graph


@pytest.mark.parametrize("wrong", [False, True])
def test_a_graph_closes_and_ignores_a_wrong_closure(wrong: bool) -> None:
    graph = square(wrong=wrong)
    assert graph.poses[8].distance(graph.poses[0]) > 0.05
    assert graph.optimize(20) > 0.01
    assert graph.poses[0] == (0.0, 0.0, 0.0, 0)
    assert graph.poses[8].distance(graph.poses[0]) < 0.005
    assert (graph.errors()[-1] > 50.0) == wrong


def test_an_offset_measures_from_a_place_in_the_second_node() -> None:
    graph = PoseGraph()
    graph.add(Pose(1.0, 2.0, 0.3))
    truth = Pose(3.0, 1.0, -0.8)
    graph.add(truth @ Pose(0.2, 0.1, 0.1))
    offset = Pose(2.0, 1.0, 0.5)
    graph.join(0, 1, graph.poses[0].inverse @ truth @ offset, np.eye(3), offset=offset)
    graph.optimize()
    assert off(graph.poses[1], truth)[0] < 1e-4
