"""The depth camera's kernel, compiled and uncompiled, compared with analytic depths and with brute force."""

from __future__ import annotations

import math
from types import ModuleType

import numpy as np
import pytest

from sim import depth_kernel
from tests.support.uncompiled import uncompiled

MODULES = (depth_kernel, uncompiled("sim.depth_kernel"))
LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""A camera that looks along the world's x."""

NONE = np.zeros((0, 8))
COUNT, FOCAL = 41, 30.0  # with 41 columns and rows, the middle is column 20 and row 20


def solid(x: float, y: float, half: float, wide: float, low: float, high: float, yaw: float = 0.0) -> list[float]:
    """Return one solid for `render`; a cylinder if ``wide`` is 0."""
    return [x, y, math.cos(yaw), math.sin(yaw), half, wide, low, high]


def render(
    module: ModuleType,
    solids: list[list[float]] | np.ndarray = NONE,
    drops: list[list[float]] | np.ndarray = NONE,
    eye: tuple[float, ...] = (0.0, 0.0, 1.0),
    turned: np.ndarray = LEVEL,
    farthest: float = 20.0,
) -> np.ndarray:
    """Return the depths of 41 x 41 pixels."""
    lens = np.array([FOCAL, FOCAL, COUNT // 2, COUNT // 2])
    out = np.full((COUNT, COUNT), -1.0, np.float32)
    solids, drops = (np.array(rows, float).reshape(-1, 8) for rows in (solids, drops))
    module.render(solids, drops, np.array(eye), np.ascontiguousarray(turned), lens, farthest, out)
    return out


def looking(yaw: float, pitch: float) -> np.ndarray:
    """Return the rotation of a camera turned to the left, then down, in radians."""
    c, s, cp, sp = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]) @ LEVEL


@pytest.mark.parametrize("module", MODULES, ids=("compiled", "uncompiled"))
class TestAnalytic:
    def test_a_wall_has_one_depth_and_the_floor_one_per_row(self, module: ModuleType) -> None:
        seen = render(module, [solid(3.1, 0.0, 0.1, 9.0, 0.0, 2.45)])
        rows = (np.arange(COUNT) - COUNT // 2) / FOCAL
        floor = np.where(rows > 1e-9, 1.0 / np.maximum(rows, 1e-9), math.inf)
        wanted = np.where(rows * 3.0 > 1.0, floor, np.where(rows * 3.0 < -1.45, math.inf, 3.0))
        np.testing.assert_allclose(seen, np.broadcast_to(wanted[:, None], seen.shape), rtol=1e-6)

    def test_a_board_is_seen_from_above_and_the_floor_beneath_it(self, module: ModuleType) -> None:
        seen = render(module, [solid(2.0, 0.0, 0.5, 0.5, 0.7, 0.75)])
        # the near edge, 1.5 m away and 0.25 to 0.3 m below the eye, is 5 to 6 rows below the middle, the far edge 3;
        # under the near edge, the floor beneath the board is visible
        assert seen[27, 20] == pytest.approx(1.0 / (7 / FOCAL), rel=1e-6)
        assert seen[25, 20] == pytest.approx(1.5, rel=1e-6)
        assert seen[24, 20] == pytest.approx(0.25 / (4 / FOCAL), rel=1e-6)
        assert seen[22, 20] == pytest.approx(1.0 / (2 / FOCAL), rel=1e-6)

    def test_a_column_is_round(self, module: ModuleType) -> None:
        seen = render(module, [solid(2.0, 0.0, 0.4, 0.0, 0.0, 2.0)])
        assert seen[20, 20] == pytest.approx(1.6, rel=1e-6)
        slope = 3 / FOCAL
        along = (2.0 - math.sqrt(4.0 - (1 + slope**2) * (4.0 - 0.16))) / (1 + slope**2)
        assert seen[20, 17] == seen[20, 23] == pytest.approx(along, rel=1e-6)
        assert math.isinf(seen[20, 27])  # next to the cylinder, whose half width appears as 0.4 / sqrt(3.84)

    def test_a_camera_looking_down_sees_tops_and_floor(self, module: ModuleType) -> None:
        down = looking(0.3, math.pi / 2)
        seen = render(module, [solid(0.0, 0.0, 0.3, 0.0, 0.0, 0.5), solid(0.5, 0.5, 0.1, 0.1, 0.0, 0.2)], turned=down)
        assert seen[20, 20] == pytest.approx(0.5)
        assert all(np.isclose(seen, depth).any() for depth in (0.5, 0.8, 1.0))

    def test_a_drop_shows_its_bottom_and_its_far_side(self, module: ModuleType) -> None:
        hole = solid(2.0, 0.0, 0.55, 5.0, -0.2, 0.0)
        seen = render(module, drops=[hole], turned=looking(0.0, math.pi / 4))
        plain = render(module, turned=looking(0.0, math.pi / 4))
        assert not np.array_equal(seen, plain)
        rows = (np.arange(COUNT) - COUNT // 2) / FOCAL
        ahead, down = math.sqrt(0.5) * (1 - rows), math.sqrt(0.5) * (1 + rows)  # components of a ray of depth 1
        at_floor, at_ground = ahead / down, ahead * 1.2 / down
        over = (at_floor >= 1.45) & (at_floor <= 2.55)
        wanted = np.where(over, np.minimum(1.2 / down, 2.55 / ahead), 1.0 / down)
        assert (over & (at_ground > 2.55)).any()
        np.testing.assert_allclose(seen[:, 20], wanted, rtol=1e-6)

    def test_solids_too_far_behind_or_around_the_camera_are_not_seen(self, module: ModuleType) -> None:
        assert np.isinf(render(module, [solid(3.0, 0.0, 0.1, 9.0, 0.0, 9.0)], farthest=2.0)[:35]).all()
        assert np.isinf(render(module, [solid(-3.0, 0.0, 0.1, 9.0, 0.0, 9.0)])[:20]).all()
        inside = render(module, [solid(0.0, 0.0, 1.0, 1.0, 0.0, 2.0)])
        np.testing.assert_array_equal(inside, render(module))

    @pytest.mark.parametrize("odd", [math.nan, math.inf, -math.inf])
    def test_invalid_solids_hide_nothing(self, module: ModuleType, odd: float) -> None:
        wall = solid(3.0, 0.0, 0.1, 0.5, 0.0, 2.0)
        with np.errstate(all="ignore"):
            rows = [[odd if i == place else v for i, v in enumerate(wall)] for place in range(8)]
            seen = render(module, [*rows, solid(1.0, 0.0, 0.1, 0.5, 1.0, 1.0), solid(1.0, 0.0, -0.1, 0.0, 0.0, 2.0)])
        np.testing.assert_array_equal(seen, render(module))

    def test_arrays_of_wrong_shapes_are_rejected(self, module: ModuleType) -> None:
        with pytest.raises(ValueError, match=r"\(n, 8\)"):
            module.render(np.zeros((1, 7)), NONE, np.zeros(3), LEVEL, np.ones(4), 9.0, np.zeros((2, 2), np.float32))
        for lens in ((0.0, 1.0, 0.0, 0.0), (1.0, math.nan, 0.0, 0.0), (1.0, 1.0, math.inf, 0.0)):
            with pytest.raises(ValueError, match="focal lengths above 0"):
                module.render(NONE, NONE, np.zeros(3), LEVEL, np.array(lens), 9.0, np.zeros((2, 2), np.float32))
        with pytest.raises(ValueError, match="must be finite"):
            render(module, eye=(0.0, math.nan, 1.0))


def brute(solids: np.ndarray, eye: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """Compute the depths of all pixels by brute force, from the intersections with the six faces of each box."""
    rows, columns = np.indices((COUNT, COUNT))
    rays = np.stack(((columns - COUNT // 2) / FOCAL, (rows - COUNT // 2) / FOCAL, np.ones(rows.shape)), -1) @ turned.T
    with np.errstate(all="ignore"):
        depths = np.where(rays[..., 2] < 0, -eye[2] / rays[..., 2], math.inf)
        for x, y, c, s, half, wide, low, high in solids:
            turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
            origin, directions = turn @ (eye - (x, y, 0.0)), rays @ turn.T
            sides = (np.array((-half, -wide, low)), np.array((half, wide, high)))
            for axis in range(3):
                for side in sides:
                    t = (side[axis] - origin[axis]) / directions[..., axis]
                    hit = origin + t[..., None] * directions
                    others = [i for i in range(3) if i != axis]
                    within = np.all([(hit[..., i] >= sides[0][i]) & (hit[..., i] <= sides[1][i]) for i in others], 0)
                    depths = np.where(within & (t > 0), np.minimum(depths, t), depths)
    return depths


@pytest.mark.parametrize("seed", range(8))
def test_boxes_equal_brute_force_compiled_and_uncompiled(seed: int) -> None:
    rng = np.random.default_rng(seed)
    solids = []
    while len(solids) < 25:
        x, y, low = (*rng.uniform(-6.0, 6.0, 2), rng.uniform(0.0, 1.5))
        half, wide = rng.uniform(0.02, 1.2, 2)
        if math.hypot(x, y) > 1.8:
            solids.append(solid(x, y, half, wide, low, low + rng.uniform(0.02, 1.5), rng.uniform(0.0, 7.0)))
    eye, turned = np.array([0.0, 0.0, 1.1]), looking(rng.uniform(-3.0, 3.0), rng.uniform(-0.3, 1.2))
    compiled, plain = (render(module, solids, eye=tuple(eye), turned=turned, farthest=50.0) for module in MODULES)
    np.testing.assert_array_equal(compiled, plain)
    wanted = brute(np.array(solids), eye, turned)
    wanted[wanted > 50.0] = math.inf
    same = np.isclose(compiled, wanted, rtol=1e-5)
    assert same.mean() > 0.999  # rays that graze an edge may differ in the last bit and pass the edge
    assert np.isfinite(compiled).any()
