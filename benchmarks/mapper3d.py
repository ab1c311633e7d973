"""Mapper3D, which builds the same tree from a depth image as octomap from the same points, several times as fast.

The camera has a RealSense D435's field of view, and turns in a room with tables; its depth has noise. "Ours" is all
that the module does with an image: depth to points, points to the map's frame, rays, the voxels' odds, and once per
second the search for outdated obstacles (which finds none, because the default run is shorter than ``forget_after``).
The peer is only ``insertPointCloud`` of the same points on the map, with ``discretize``; a test checks that the trees
are equal.
`make bench-peers` installs the peer. After each image a layer is computed and published on a hub: as a grid with its
update, and the heights of obstacles.
"""

from __future__ import annotations

import argparse
import importlib
import math
import statistics
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

if not __package__:  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.rows import Row, add_json_option, need_peers, report
from bridge.config.model import Config
from bridge.hub.node import Hub
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages.registry import Registry
from bridge.modules.host import Host
from navigation.mapper3d.depth import Camera, Rays
from navigation.mapper3d.layer import UPDATE, LayerPublisher
from navigation.mapper3d.section import Mapper3DSection
from navigation.mapper3d.space import OPTICAL, FieldOfView, SensorPose, Space
from navigation.maps.grid_map import GRID_MAP, HEIGHTS
from navigation.messages import GRID
from tests.peers.hub.quick import QuickHub

WIDTH, HEIGHT, RATE = 640, 480, 5.0
FOCUS = WIDTH / 2 / math.tan(math.radians(87.0) / 2)
CAMERA = Camera(WIDTH, HEIGHT, FOCUS, FOCUS, WIDTH / 2 - 0.5, HEIGHT / 2 - 0.5)
MOST = 0.4
"""Limit: share of a core at ``RATE`` images per second."""


def seat(turn: float) -> SensorPose:
    """Return a camera 1 m above the floor, turned to the left (radians) and 15 degrees down."""
    down = math.radians(15.0)
    pitch = np.array([[math.cos(down), 0, math.sin(down)], [0, 1, 0], [-math.sin(down), 0, math.cos(down)]])
    yaw = np.array([[math.cos(turn), -math.sin(turn), 0], [math.sin(turn), math.cos(turn), 0], [0, 0, 1]])
    return SensorPose(yaw @ pitch @ OPTICAL, (0.11, 0.07, 1.02))


def depth(at: SensorPose, size: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return the camera's depth in a square room of a size in meters, 2.6 m high, with two tables."""
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays = (
        np.stack(((u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones_like(u, float)), -1) @ at.rotation.T
    )
    depths = np.full(u.shape, np.inf)
    origin = np.array(at.origin)
    tables = [((1.2, -0.9), (2.0, 0.9)), ((-1.5, 0.8), (-0.8, 1.6))]
    surfaces: list[tuple[int, float, Any]] = [(axis, sign * size / 2, None) for axis in (0, 1) for sign in (-1.0, 1.0)]
    surfaces += [(2, 0.0, None), (2, 2.6, None), *((2, 0.74, table) for table in tables)]
    with np.errstate(divide="ignore", invalid="ignore"):
        for axis, place, within in surfaces:
            crossings = (place - origin[axis]) / rays[..., axis]
            hit = (crossings > 0.0) & (crossings < depths)
            if within is not None:
                spot = (origin + rays * crossings[..., None])[..., :2]
                hit &= ((spot > within[0]) & (spot < within[1])).all(-1)
            depths = np.where(hit, crossings, depths)
    noise = rng.normal(0.0, 0.001, depths.shape) * depths**2
    return np.asarray(depths + noise, np.float32)


def images(count: int, size: float) -> list[tuple[SensorPose, NDArray[np.float32]]]:
    """Return images of a turning camera."""
    rng = np.random.default_rng(0)
    seats = [seat(0.1 * index) for index in range(count)]
    return [(seat_, depth(seat_, size, rng)) for seat_ in seats]


def placed(at: SensorPose, seen: NDArray[np.float32], every: int) -> NDArray[np.float64]:
    """Return the points of an image on the map."""
    points = Rays(every).points(seen, CAMERA)
    return (points @ at.rotation.T.astype(np.float32) + np.array(at.origin, np.float32)).astype(np.float64)


def ours(shots: list[tuple[SensorPose, NDArray[np.float32]]], settings: Mapper3DSection) -> float:
    """Return Mapper3D's processor time per image, in milliseconds."""
    space, rays = Space(settings), Rays(settings.pixels)
    begin = time.process_time()
    for index, (at, seen) in enumerate(shots):
        space.add(rays.points(seen, CAMERA), at, FieldOfView(OPTICAL, CAMERA.view), index / RATE)
    return 1000.0 * (time.process_time() - begin) / len(shots)


def octomaps(shots: list[tuple[SensorPose, NDArray[np.float32]]], settings: Mapper3DSection) -> float:
    """Return octomap's processor time per image, in milliseconds; its points are already in the map's frame."""
    tree = importlib.import_module("pyoctomap").OcTree(settings.resolution)
    clouds = [(placed(at, seen, settings.pixels), np.array(at.origin)) for at, seen in shots]
    begin = time.process_time()
    for points, origin in clouds:
        tree.insertPointCloud(points, origin, max_range=settings.farthest, discretize=True)
    return 1000.0 * (time.process_time() - begin) / len(shots)


def layer(shots: list[tuple[SensorPose, NDArray[np.float32]]], settings: Mapper3DSection) -> tuple[float, float]:
    """Return the median milliseconds of computing a layer, and of publishing it to a subscriber, after each image."""
    space, rays = Space(settings), Rays(settings.pixels)
    computing, publishing = [], []
    with QuickHub() as network, Hub.open(network.settings("listener")) as listener:
        host = Host("mapper3d", Config.model_validate({"name": "bench", "hub": network.config()}), Registry())
        publisher, received = LayerPublisher(host, settings), threading.Event()
        for end, kind in (("", GRID), ("_updates", UPDATE), (HEIGHTS, GRID_MAP)):
            listener.subscription(f"{settings.layer.topic}{end}", kind, "*", LATCHED if end != "_updates" else Qos(),
                                  lambda _: received.set())  # fmt: skip
        for index, (at, seen) in enumerate(shots):
            space.add(rays.points(seen, CAMERA), at, FieldOfView(OPTICAL, CAMERA.view), index / RATE)
            begin = time.thread_time()
            result = space.layer((0.0, 0.0, 0.0))
            middle = time.thread_time()
            publisher.publish(result)
            computing.append(middle - begin)
            publishing.append(time.thread_time() - middle)
            received.wait(10.0)  # once a message has arrived, the subscriber is connected
        host.close()
    return 1000.0 * statistics.median(computing), 1000.0 * statistics.median(publishing)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=30, help="number of images per room")
    parser.add_argument("--rooms", type=float, nargs="+", default=[5.0, 10.0], metavar="METERS")
    add_json_option(parser)
    args = parser.parse_args()
    need_peers("pyoctomap")
    rows = []
    for size in args.rooms:
        shots = images(args.images, size)
        for every in (1, 2):
            settings = Mapper3DSection(pixels=every, forget_after=30.0)
            case, cost = f"room of {size:g} m, {WIDTH // every} x {HEIGHT // every}", ours(shots, settings)
            rows.append(Row(f"{case}, octomap", cost, octomaps(shots, settings), "ms"))
            rows.append(Row(f"{case}, at {RATE:g} Hz", 0.1 * cost * RATE, 100.0 * MOST, "% core"))
        for step, cost in zip(("computed", "published"), layer(shots, Mapper3DSection()), strict=True):
            rows.append(Row(f"room of {size:g} m, layer {step}", cost, 1000.0 * MOST / RATE, "ms"))
    report(rows, args.json)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
