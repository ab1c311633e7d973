"""The message packages that Midspan always has on the ROS 2 side, though no wheel brings them."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from bridge.interfaces.folders import read_package_folder

DEFINITIONS = Path(__file__).parent / "definitions"
"""Folder with their definitions; its README says where the field lists come from."""


@cache
def standing_packages() -> tuple[str, ...]:
    """Names of the packages whose definitions come with Midspan."""
    return tuple(sorted(entry.name for entry in DEFINITIONS.iterdir() if entry.is_dir()))


def standing_files(package: str) -> dict[str, str]:
    """A standing package's definitions by path, as `bridge.interfaces.builder.build` takes them; {} for any other."""
    return read_package_folder(DEFINITIONS / package) if package in standing_packages() else {}
