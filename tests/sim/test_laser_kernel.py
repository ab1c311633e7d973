"""The laser's kernels, compiled and uncompiled, with invalid numbers; test_laser checks the distances."""

from __future__ import annotations

import math
from types import ModuleType

import numpy as np
import pytest

from sim import laser_kernel
from tests.support.uncompiled import uncompiled

MODULES = (laser_kernel, uncompiled("sim.laser_kernel"))
WALL = np.array([(1.0, -5.0, 1.0, 5.0)])
NO_CIRCLES = np.empty((0, 3))


def cast(
    module: ModuleType,
    segments: np.ndarray = WALL,
    circles: np.ndarray = NO_CIRCLES,
    pose: tuple[float, ...] = (0.0, 0.0, 0.0),
    count: int = 8,
    first: float = -math.pi,
    step: float | None = None,
    farthest: float = 20.0,
) -> np.ndarray:
    """Return the distances of beams in all directions."""
    between = math.tau / max(count, 1)
    angles = -math.pi + np.arange(count) * between
    beams = np.ascontiguousarray(np.stack([np.cos(angles), np.sin(angles)], axis=1))
    out = np.full(count, -1.0)
    with np.errstate(all="ignore"):
        module.cast(segments, circles, *pose, beams, first, between if step is None else step, farthest, out)
    return out


def test_compiled_and_uncompiled_measure_the_same() -> None:
    rng = np.random.default_rng(4)
    for count, first in ((1, 0.0), (90, -math.pi), (400, 5.0)):
        for _ in range(4):
            segments, circles = rng.uniform(-9.0, 9.0, (25, 4)), rng.uniform((-9, -9, 0.05), (9, 9, 1), (5, 3))
            segments[::6, 2:] = segments[::6, :2]
            segments[rng.integers(0, 25, 3), rng.integers(0, 4, 3)] = (math.nan, math.inf, 1e300)
            circles[0, rng.integers(0, 3)] = rng.choice([math.nan, math.inf, 1e300])
            pose = tuple(rng.uniform(-7.0, 7.0, 3).tolist())
            compiled, plain = (cast(module, segments, circles, pose, count, first) for module in MODULES)
            np.testing.assert_array_equal(compiled, plain)
            compiled[::5] = math.nan
            merged = np.full((2, 64), math.nan)
            for module, row in zip(MODULES, merged, strict=True):
                with np.errstate(all="ignore"):
                    module.blend(compiled, first, math.tau / count, 0.2, -0.1, pose[2], row, math.tau / 64)
            np.testing.assert_array_equal(merged[0], merged[1])
            assert count < 90 or np.isfinite(merged[0]).any()


@pytest.mark.parametrize("module", MODULES, ids=("compiled", "uncompiled"))
class TestInvalidNumbers:
    @pytest.mark.parametrize("odd", [math.nan, math.inf, -math.inf])
    @pytest.mark.parametrize("axis", range(3))
    def test_nothing_is_seen_from_an_invalid_pose(self, module: ModuleType, odd: float, axis: int) -> None:
        pose = [0.0, 0.0, 0.0]
        pose[axis] = odd
        assert np.isinf(cast(module, pose=tuple(pose))).all()
        assert np.isinf(cast(module, first=odd)).all()

    @pytest.mark.parametrize("farthest", [20.0, math.inf])
    @pytest.mark.parametrize("odd", [math.nan, math.inf, -math.inf, 1e300])
    def test_invalid_shapes_hide_nothing(self, module: ModuleType, odd: float, farthest: float) -> None:
        segments = np.vstack([WALL, *(np.where(np.arange(4) == axis, odd, 0.5) for axis in range(4))])
        circles = np.array([(odd, 0.5, 0.1), (0.5, odd, 0.1), (0.5, 0.5, math.nan), (0.5, 0.5, -1.0), (5.0, 0.5, odd)])
        seen = cast(module, segments, circles, farthest=farthest)
        assert seen[4] == pytest.approx(1.0)
        assert np.isinf(seen[:3]).all()

    def test_nothing_is_seen_without_shapes_or_beams(self, module: ModuleType) -> None:
        assert np.isinf(cast(module, np.empty((0, 4)))).all()
        assert not len(cast(module, count=0))

    def test_steps_must_be_above_zero(self, module: ModuleType) -> None:
        for step in (0.0, -0.1, math.nan):
            with pytest.raises(ValueError, match="0 radians apart"):
                cast(module, step=step)
            with pytest.raises(ValueError, match="0 radians apart"):
                module.blend(np.ones(3), 0.0, 0.1, 0.0, 0.0, 0.0, np.empty(3), step)
        for step in (1e-300, 1e-12, 1e300, math.inf):  # the kernel returns in any case
            assert len(cast(module, circles=np.array([(-1.0, 0.0, 0.3)]), step=step)) == 8

    def test_arrays_of_wrong_shapes_are_rejected(self, module: ModuleType) -> None:
        for segments, circles in ((WALL[:, :3].copy(), NO_CIRCLES), (WALL, np.empty((0, 2)))):
            with pytest.raises(ValueError, match=r"\(n, 4\)"):
                cast(module, segments, circles)
        with pytest.raises(ValueError, match=r"\(n, 4\)"):
            module.cast(WALL, NO_CIRCLES, 0.0, 0.0, 0.0, np.zeros((3, 2)), 0.0, 1.0, 9.0, np.empty(2))

    @pytest.mark.parametrize("odd", [math.nan, math.inf, 1e300])
    def test_scanners_at_invalid_poses_add_nothing(self, module: ModuleType, odd: float) -> None:
        scan = np.array([1.0, math.inf, 1.0, math.nan, 1e300])
        with np.errstate(all="ignore"):
            for place in range(5):
                given, merged = [0.0, 0.1, 0.0, 0.0, 0.0], np.full(8, math.nan)
                given[place] = odd
                module.blend(scan, *given, merged, math.tau / 8)
                assert np.isnan(merged).all() or (math.isfinite(odd) and (merged[~np.isnan(merged)] >= 1.0).all())
            few = np.full(4, math.nan)
            module.blend(scan, 0.0, 1.2, 0.0, 0.0, 0.0, few, 0.1)  # fewer slots than directions
            assert np.isnan(few[1:]).all()
            module.blend(scan, 0.0, 1.2, 0.0, 0.0, 0.0, np.empty(0), 0.1)
