"""Maps in three dimensions on the command line: what they are, and between octomaps and clouds."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from bridge.cli.maps.store import missing, open_stored
from bridge.cli.output import CliError, clean
from bridge.stores.kinds import MAP3D, Map3D
from yarp_compat.octomap import Octomap
from yarp_compat.octree import OCCUPIED, OcTree
from yarp_compat.sig.cloudfile import write_pcd, write_ply
from yarp_compat.sig.pointcloud import LAYOUTS, PointCloud, PointType
from yarp_compat.wire.errors import WireError


def described(name: str, value: Map3D) -> dict[str, Any]:
    """What a map is: its form, its counts, and its bounds in metres (null where it is empty)."""
    if isinstance(value, PointCloud):
        kind = PointType(value.getPointType()).name.lower().replace("_", " ")
        found = {"form": "cloud", "type": kind, "points": value.size()}
        places = value.numpy()
        corners = np.stack([places[axis] for axis in "xyz"], axis=1)
        corners = corners[np.isfinite(corners).all(axis=1)]
        low, high = (corners, corners)
    else:
        voxels = value.voxels()
        found = {
            "form": "octomap", "type": value.id, "binary": value.binary, "resolution": value.resolution,
            "leaves": len(voxels.sizes), "occupied": int(voxels.occupied.sum()),
        }  # fmt: skip
        half = voxels.sizes[:, None] / 2
        low, high = voxels.centers - half, voxels.centers + half
    bounds = [[round(float(n), 3) for n in part] for part in (low.min(axis=0), high.max(axis=0))] if len(low) else None
    return {"name": name, **found, "bounds": bounds}


def line(found: dict[str, Any]) -> str:
    """The same as a line."""
    if found["form"] == "cloud":
        what = f"cloud of {found['points']} points ({found['type']})"
    else:
        form = "free or occupied" if found["binary"] else "probabilities"
        what = f"{found['type']} of {found['leaves']} leaves, {found['occupied']} occupied ({form})"
        what += f", cells of {found['resolution']:g} m"
    bounds = found["bounds"]
    where = " to ".join(", ".join(f"{number:g}" for number in corner) for corner in bounds) if bounds else "empty"
    return f"3D {clean(found['name'])}: {what}; {where}" + (" m" if bounds else "")


def show(args: argparse.Namespace) -> int:
    """Say what a map is."""
    name, value = _named(args)
    print(line(described(name, value)))
    return 0


def export(args: argparse.Namespace) -> int:
    """Write a map in three dimensions by the file's ending."""
    name, value = _named(args)
    form = args.file.suffix.lower()
    try:
        if form in (".pcd", ".ply"):
            cloud = value if isinstance(value, PointCloud) else _centres(value)
            data = write_pcd(cloud) if form == ".pcd" else write_ply(cloud)
        else:
            octomap = _voxels(value, args.resolution) if isinstance(value, PointCloud) else value
            data = octomap.bt() if form == ".bt" else octomap.ot()
    except WireError as err:
        raise CliError(str(err)) from None
    args.file.write_bytes(data)
    print(f"{clean(name)} to {args.file}")
    return 0


def _named(args: argparse.Namespace) -> tuple[str, Map3D]:
    with open_stored(args) as (_, stored):
        names = stored.names(MAP3D)
        name = args.name or (names[0] if len(names) == 1 else "")
        value = stored.get(MAP3D, name) if name else None
    if value is None:
        raise CliError(missing("map3d", name, names) if name else f"which one? there are {len(names)} maps in 3D")
    return name, value


def _centres(octomap: Octomap) -> PointCloud:
    voxels = octomap.voxels()
    points = np.zeros(int(voxels.occupied.sum()), LAYOUTS[PointType.XYZ])
    for axis, name in enumerate("xyz"):
        points[name] = voxels.centers[voxels.occupied, axis]
    return PointCloud.of(points)


def _voxels(cloud: PointCloud, resolution: float) -> Octomap:
    points = np.stack([cloud.numpy()[axis].astype(float) for axis in "xyz"], axis=1)
    tree = OcTree.of(np.zeros((0, 3), int), [], resolution=resolution)  # checks the resolution
    points = points[np.isfinite(points).all(axis=1)]
    keys = np.floor(points / resolution) + 32768
    if len(keys):
        tree = OcTree.of(np.unique(np.clip(keys, -1, 65536).astype(np.int64), axis=0), OCCUPIED, resolution=resolution)
    return Octomap.of(tree.pruned())
