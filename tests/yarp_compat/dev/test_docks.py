"""Docks are stored among the locations, in YARP's files too."""

from __future__ import annotations

from pathlib import Path

import pytest

from yarp_compat.dev.docks import Dock, dock_of
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.places import Places


@pytest.mark.parametrize(
    ("description", "dock"),
    [
        ("", None),
        ("beside the dock", None),
        ("kind=docking", None),
        ("unkind=dock", None),
        ("dock_type=contacts", None),
        ("kind=dock", Dock()),
        ("the charger, kind=dock dock_type=contacts", Dock("contacts")),
        ("dock_type=a.b/c-d_1, kind=dock", Dock("a.b/c-d_1")),
    ],
)
def test_a_description_makes_a_location_a_dock(description: str, dock: Dock | None) -> None:
    assert dock_of(Map2DLocation("m", 1.0, 2.0, 3.0, description)) == dock


def test_docks_survive_yarps_files(tmp_path: Path) -> None:
    file, dock = tmp_path / "locations.ini", Dock("contacts")
    charger = Map2DLocation("lab", 1.25, -2.5, 90.0, f"in the lab, {dock.to_text()}")
    places = Places()
    places.locations["charger"] = charger
    places.save(file)
    again = Places.load(file).locations["charger"]
    assert (again, dock_of(again)) == (charger, dock)


def test_a_dock_type_that_is_not_one_word_is_rejected() -> None:
    with pytest.raises(ValueError, match="a dock's type may only have letters"):
        Dock("two words").to_text()
