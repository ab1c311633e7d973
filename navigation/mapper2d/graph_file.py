"""The file with a map's scans and their graph, from which mapping can continue later.

It is a NumPy archive (``.npz``) without pickled objects; poses are x, y, theta in meters and radians.
"""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navigation.algorithms.pose_graph import Edge
from navigation.algorithms.slam import MOST_SUBMAPS
from navigation.algorithms.submaps import Submaps, View
from navigation.pose import Pose

SUFFIX = ".graph.npz"

_VERSION = 1
_LARGEST = 512 * 2**20  # bytes, uncompressed
_MOST_PAINT = 100_000_000  # cells
_ARRAYS = {
    "version": (0, "u8"), "poses": (2, "f8"), "nodes": (2, "i8"), "offsets": (2, "f8"), "measured": (2, "f8"),
    "information": (3, "f8"), "loops": (1, "b1"), "submaps": (1, "i8"), "places": (2, "f8"), "angles": (2, "f8"),
    "beams": (1, "i8"), "millimeters": (1, "u2"), "paint": (2, "u1"), "corner": (1, "f8"),
}  # fmt: skip
"""The arrays, with their numbers of dimensions and types."""


class SavedGraph(NamedTuple):
    """What the file contains.

    Attributes:
        submaps: the submaps, with their views and graph.
        paint, corner: see `Mapper.painted`.
    """

    submaps: Submaps
    paint: NDArray[np.uint8]
    corner: tuple[float, float]


@contextmanager
def replacing(path: Path, saved: SavedGraph | None) -> Iterator[None]:
    """Replace the graph of a map, or remove it for None, while the body saves the map; raises `OSError`.

    An error, even one of the body, leaves the previous graph. If the process is killed, the map may lose its graph,
    but it never has the graph of an earlier map.
    """
    part, before = path.with_name(path.name + ".part"), path.with_name(path.name + ".before")
    if saved is not None:
        write(part, saved)  # first, because a full disk makes this fail
    before.unlink(missing_ok=True)  # of a process that was killed
    with suppress(FileNotFoundError):
        path.replace(before)
    try:
        yield
    except BaseException:
        with suppress(FileNotFoundError):
            before.replace(path)
        part.unlink(missing_ok=True)
        raise
    if saved is not None:
        part.replace(path)
    before.unlink(missing_ok=True)


def write(path: Path, saved: SavedGraph) -> None:
    """Write a file, and create its folder; raises `OSError`."""
    submaps = saved.submaps
    edges, views = submaps.graph.edges, submaps.views
    arrays = {
        "version": np.uint64(_VERSION),
        "poses": [pose[:3] for pose in submaps.graph.poses],
        "nodes": [edge[:2] for edge in edges],
        "offsets": [edge.offset[:3] for edge in edges],
        "measured": [edge.measured[:3] for edge in edges],
        "information": [edge.information for edge in edges],
        "loops": [edge.loop for edge in edges],
        "submaps": [view.submap for view in views],
        "places": [view.pose[:3] for view in views],
        "angles": [(view.first, view.step, view.farthest) for view in views],
        "beams": [view.millimeters.size for view in views],
        "millimeters": np.concatenate([view.millimeters for view in views]) if views else [],
        "paint": saved.paint,
        "corner": saved.corner,
    }
    data = io.BytesIO()
    np.savez_compressed(data, **{name: np.asarray(value, _ARRAYS[name][1]) for name, value in arrays.items()})  # type: ignore[arg-type]
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        path.write_bytes(data.getvalue())
    except OSError:
        path.unlink(missing_ok=True)  # it may be incomplete
        raise


def read(path: Path) -> SavedGraph:
    """Read a file; raises `OSError`, or `ValueError` with the reason if its content is invalid."""
    try:
        _check_size(path)
        with np.load(path, allow_pickle=False) as loaded:
            arrays = {name: _array(loaded[name], *kind) for name, kind in _ARRAYS.items()}
        return _parse(arrays)
    except (ValueError, KeyError, IndexError, EOFError, zipfile.BadZipFile, zlib.error) as err:
        raise ValueError(f"cannot read the graph of the map, {path.name}: {err}") from None


def _check_size(path: Path) -> None:
    with zipfile.ZipFile(path) as archive:
        if sum(entry.file_size for entry in archive.infolist()) > _LARGEST:
            raise ValueError(f"it is larger than {_LARGEST // 2**20} MB")


def _pose(values: NDArray[Any]) -> Pose:
    x, y, theta = map(float, values)
    return Pose(x, y, theta)


def _array(values: NDArray[Any], dimensions: int, kind: str) -> NDArray[Any]:
    if values.dtype != np.dtype(kind) or (values.ndim != dimensions and values.size):
        raise ValueError(f"an array has {values.ndim} dimensions of {values.dtype}, not {dimensions} of {kind}")
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise ValueError("a number is not finite")
    return values


def _parse(arrays: dict[str, NDArray[Any]]) -> SavedGraph:
    if int(arrays["version"].item()) != _VERSION:
        raise ValueError(f"its version is {arrays['version']}, not {_VERSION}")
    poses, nodes, owners, beams = (arrays[name] for name in ("poses", "nodes", "submaps", "beams"))
    lengths = {len(arrays[name]) for name in ("nodes", "offsets", "measured", "information", "loops")}
    views = {len(arrays[name]) for name in ("submaps", "places", "angles", "beams")}
    count = len(poses)
    if len(lengths) != 1 or len(views) != 1 or not 1 <= count <= MOST_SUBMAPS:
        raise ValueError(f"it has {count} submaps, and arrays of different lengths")
    for indices in (nodes, owners):
        if indices.size and not (indices.min() >= 0 and indices.max() < count):
            raise ValueError("it refers to a submap that it does not have")
    if (beams.size and beams.min() < 0) or int(beams.sum()) != arrays["millimeters"].size:
        raise ValueError("its scans have the wrong number of beams")
    if arrays["paint"].size > _MOST_PAINT or arrays["corner"].shape != (2,):
        raise ValueError("its paint is invalid")
    submaps = Submaps()
    for pose in poses:
        submaps.begin(_pose(pose))
    for number, (first, second) in enumerate(nodes):
        offset, measured = (_pose(arrays[name][number]) for name in ("offsets", "measured"))
        information = np.array(arrays["information"][number], np.float64).reshape(3, 3)
        submaps.graph.edges.append(
            Edge(int(first), int(second), offset, measured, information, bool(arrays["loops"][number]))
        )
    scans = np.split(np.asarray(arrays["millimeters"], np.uint16), np.cumsum(beams)[:-1].astype(np.intp))
    for owner, place, angles, scan in zip(owners, arrays["places"], arrays["angles"], scans, strict=False):
        submaps.add(View(int(owner), _pose(place), scan.copy(), *map(float, angles)))
    x, y = map(float, arrays["corner"])
    return SavedGraph(submaps, np.asarray(arrays["paint"], np.uint8), (x, y))
