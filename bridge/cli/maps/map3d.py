"""3D maps on the command line: descriptions, slices, and conversions between octomaps and clouds."""

from __future__ import annotations

import argparse
import math
from typing import Any

import numpy as np

from bridge.cli.maps.store import missing, open_stored
from bridge.cli.output import CliError
from bridge.client.store import StoreClient
from bridge.stores.kinds import MAP3D, Map3D
from bridge.text import clean
from yarp_compat.dev.mapgrid import MAX_CELLS, MapFlag, MapGrid2D, too_large
from yarp_compat.octomap import Octomap
from yarp_compat.octree import MIDDLE, OCCUPIED, OcTree
from yarp_compat.sig.cloudfile import write_pcd, write_ply
from yarp_compat.sig.pointcloud import LAYOUTS, PointCloud, PointType
from yarp_compat.wire.errors import WireError


def described(name: str, value: Map3D) -> dict[str, Any]:
    """Describe a map: its form, its counts, and its bounds in meters (null if it is empty)."""
    if isinstance(value, PointCloud):
        kind = PointType(value.getPointType()).name.lower().replace("_", " ")
        description = {"form": "cloud", "type": kind, "points": value.size()}
        fields = value.numpy()
        corners = np.stack([fields[axis] for axis in "xyz"], axis=1)
        corners = corners[np.isfinite(corners).all(axis=1)]
        low, high = (corners, corners)
    else:
        voxels = value.voxels()
        description = {
            "form": "octomap", "type": value.id, "binary": value.binary, "resolution": value.resolution,
            "leaves": len(voxels.sizes), "occupied": int(voxels.occupied.sum()),
        }  # fmt: skip
        half = voxels.sizes[:, None] / 2
        low, high = voxels.centers - half, voxels.centers + half
    bounds = [[round(float(n), 3) for n in part] for part in (low.min(axis=0), high.max(axis=0))] if len(low) else None
    return {"name": name, **description, "bounds": bounds}


def line(description: dict[str, Any]) -> str:
    """Format a description as one line."""
    if description["form"] == "cloud":
        text = f"cloud of {description['points']} points ({description['type']})"
    else:
        form = "free or occupied" if description["binary"] else "probabilities"
        text = f"{description['type']} of {description['leaves']} leaves, {description['occupied']} occupied ({form})"
        text += f", cells of {description['resolution']:g} m"
    bounds = description["bounds"]
    where = " to ".join(", ".join(f"{number:g}" for number in corner) for corner in bounds) if bounds else "empty"
    return f"3D {clean(description['name'])}: {text}; {where}" + (" m" if bounds else "")


def show(args: argparse.Namespace) -> int:
    """Print the description of a map."""
    with open_stored(args) as (_, stored):
        name, value = named_map3d(stored, args.name)
    print(line(described(name, value)))
    return 0


def layer(name: str, value: Map3D, height: float) -> MapGrid2D:
    """Return the slice of an octomap at a height (m), with occupied leaves as walls.

    Raises `CliError` if the map is a cloud, or the slice is empty or too large.
    """
    if isinstance(value, PointCloud):
        raise CliError(f"{name!r} is a cloud, which has no free space; export it as .bt, and import that")
    if not math.isfinite(height):
        raise CliError(f"--layer is a height in meters, not {height}")
    tree, edge = value.tree(), value.resolution
    keys, sizes = tree.keys().astype(np.int64), tree.edges()
    low = keys[:, 2]
    wanted = math.floor(min(max(height / edge + 1e-9, -MIDDLE - 1), MIDDLE)) + MIDDLE  # + 1e-9, as 0.3 / 0.1 is 2.99...
    cut = (low <= wanted) & (wanted < low + sizes)
    if not cut.any():
        ends = [f"{(end - MIDDLE) * edge:g}" for end in (low.min(), (low + sizes).max())] if len(low) else ["none"]
        raise CliError(f"{name!r} has no data at {height:g} m; its heights in meters: {' to '.join(ends)}")
    first, last = keys[cut, :2].min(axis=0), (keys[cut, :2] + sizes[cut, None]).max(axis=0)
    width, rows = (int(n) for n in last - first)
    if width * rows > MAX_CELLS:
        raise CliError(f"{name!r} at {height:g} m: {too_large(width, rows)}")
    tree = OcTree(edge, tree.codes[cut], tree.depths[cut], tree.log_odds[cut])
    across, up = ((np.arange(first[axis], last[axis]) - MIDDLE + 0.5) * edge for axis in (0, 1))
    flags = np.empty((rows, width), np.uint8)
    middle = (wanted - MIDDLE + 0.5) * edge
    for row, y in enumerate(up[::-1]):
        leaves = tree.search(across, y, middle)
        flags[row] = np.where(np.isnan(leaves), MapFlag.UNKNOWN, np.where(leaves > 0, MapFlag.WALL, MapFlag.FREE))
    return MapGrid2D.of(flags, name=name, resolution=edge, origin=(*((first - MIDDLE) * edge).tolist(), 0.0))


def export(args: argparse.Namespace) -> int:
    """Write a 3D map in the format given by the file's extension."""
    with open_stored(args) as (_, stored):
        name, value = named_map3d(stored, args.name)
    form = args.file.suffix.lower()
    try:
        if form in (".pcd", ".ply"):
            cloud = value if isinstance(value, PointCloud) else _centers(value)
            data = write_pcd(cloud) if form == ".pcd" else write_ply(cloud)
        else:
            octomap = _voxels(value, args.resolution) if isinstance(value, PointCloud) else value
            data = octomap.bt() if form == ".bt" else octomap.ot()
    except WireError as err:
        raise CliError(str(err)) from None
    args.file.write_bytes(data)
    print(f"{clean(name)} exported to {args.file}")
    return 0


def named_map3d(stored: StoreClient, name: str | None) -> tuple[str, Map3D]:
    """Return a 3D map by its name, or the only one; raises `CliError` if it is missing, or there are several."""
    names = stored.names(MAP3D)
    name = name or (names[0] if len(names) == 1 else "")
    value = stored.get(MAP3D, name) if name else None
    if not names:
        raise CliError("no 3D map is stored; 'midspan map import house.bt' imports one")
    if value is None:
        which = f"name one of the {len(names)} 3D maps: {', '.join(map(clean, names[:10]))}"
        raise CliError(missing("map3d", name, names) if name else which)
    return name, value


def _centers(octomap: Octomap) -> PointCloud:
    voxels = octomap.voxels()
    points = np.zeros(int(voxels.occupied.sum()), LAYOUTS[PointType.XYZ])
    for axis, name in enumerate("xyz"):
        points[name] = voxels.centers[voxels.occupied, axis]
    return PointCloud.of(points)


def _voxels(cloud: PointCloud, resolution: float) -> Octomap:
    points = np.stack([cloud.numpy()[axis].astype(float) for axis in "xyz"], axis=1)
    tree = OcTree.of(np.zeros((0, 3), int), [], resolution=resolution)  # checks the resolution
    points = points[np.isfinite(points).all(axis=1)]
    keys = np.floor(points / resolution) + MIDDLE
    if len(keys):
        tree = OcTree.of(np.unique(np.clip(keys, -1, 65536).astype(np.int64), axis=0), OCCUPIED, resolution=resolution)
    return Octomap.of(tree.pruned())
