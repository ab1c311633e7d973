"""Floor plans: those that come with Midspan, and those of files."""

from __future__ import annotations

from pathlib import Path

from sim import files
from sim.errors import SimError
from sim.plan import Floor, Plan

_IMAGES = (".png", ".pgm", ".bmp", ".jpg", ".jpeg", ".gif", ".tif", ".tiff")


def load(name: str, resolution: float = 0.05) -> Plan:
    """A plan that comes with Midspan, or a file: a plan or a ROS map (YAML), a YARP map (.map), or an image.

    Args:
        name: of the plan or the file.
        resolution: metres per pixel of an image.

    Raises:
        SimError: there is none of that name, or the file is wrong.
    """
    file = files.find("plans", name)
    kind = file.suffix.lower()
    if kind in _IMAGES:
        from sim.grid import of_image

        return of_image(file, resolution)
    if kind == ".map":
        from sim.grid import of_map_file

        return of_map_file(file)
    if kind not in (".yaml", ".yml"):
        msg = f"{name}: what it is is told by its name's end: .yaml, .map, {', '.join(_IMAGES)}"
        raise SimError(msg)
    found = files.document(file)
    if "image" in found.data:
        from sim.grid import of_map_file

        return of_map_file(file)
    if "floors" in found.data:
        return files.checked(found, Plan)
    return single(file, files.checked(found, Floor))


def single(file: Path, floor: Floor) -> Plan:
    """A plan of one floor, called as its file is."""
    name = "".join(c if (c.isalnum() and c.isascii()) or c in "_-" else "_" for c in file.stem)
    return Plan(name=name if name[:1].isalpha() else f"map_{name}", floors={name: floor})
