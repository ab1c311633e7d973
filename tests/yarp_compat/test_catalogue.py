"""What `import yarp_compat as yarp` gives, and what it says of the rest."""

from __future__ import annotations

import subprocess
import sys

import pytest

import yarp_compat as yarp
from yarp_compat import catalogue


@pytest.mark.parametrize("name", catalogue.names())
def test_every_name_is_there(name: str) -> None:
    assert getattr(yarp, name) is not None
    assert name in dir(yarp)


def test_names_are_loaded_when_used_and_need_no_numpy() -> None:
    code = (
        "import sys, yarp_compat as yarp\n"
        "first = ('yarp_compat.catalogue', 'yarp_compat.absences')\n"
        "assert not [m for m in sys.modules if m.startswith('yarp_compat.') and m not in first]\n"
        "yarp.Network.setLocalMode(True); yarp.Network.init()\n"
        "p = yarp.BufferedPortBottle(); assert p.open('/p')\n"
        "yarp.RFModule, yarp.ResourceFinder, yarp.RpcClient, yarp.Publisher, yarp.rosmsg.std_msgs.String\n"
        "yarp.Network.fini()\n"
        "assert 'numpy' not in sys.modules, 'numpy was imported'\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.parametrize(
    ("name", "instead"),
    [
        ("Drivers", "yarp.PolyDriver"),
        ("IGazeControl", "the controller's rpc port"),
        ("NetworkClock", "system time"),
        ("Semaphore", "threading"),
        ("PortWriterBufferBase", "BufferedPort"),
        ("Botle", "did you mean 'Bottle'"),
        ("BufferedPortBotle", "did you mean 'BufferedPort'"),
        ("zzz", "docs/yarp/python.md"),
    ],
)
def test_what_is_missing_is_said(name: str, instead: str) -> None:
    with pytest.raises(AttributeError, match=instead):
        getattr(yarp, name)


def test_enumerators_stand_by_themselves() -> None:
    assert yarp.navigation_status_moving is yarp.NavigationStatusEnum.navigation_status_moving
    assert yarp.localization_status_localized_ok is yarp.LocalizationStatusEnum.localization_status_localized_ok
    assert yarp.local_map is yarp.NavigationMapTypeEnum.local_map
    assert yarp.global_trajectory is yarp.TrajectoryTypeEnum.global_trajectory
    with pytest.raises(AttributeError):
        _ = yarp.navigation_status_nonsense


def test_families() -> None:
    assert issubclass(yarp.BufferedPortImageRgb, yarp.BufferedPort)
    assert yarp.BufferedPortImageRgb is yarp.BufferedPortImageRgb
    assert yarp.BufferedPortBottle().prepare().size() == 0
    assert yarp.Network_exists is yarp.Network.exists
    with pytest.raises(TypeError, match="BufferedPort"):
        yarp.BufferedPort()


def test_std_vectors() -> None:
    vector = yarp.DVector(3)
    vector.push_back(1.5)
    vector.resize(5)
    assert vector == [0.0, 0.0, 0.0, 1.5, 0.0]
    vector.resize(1)
    assert (vector.size(), vector.empty(), list(yarp.SVector(["a"])), yarp.BVector(2)) == (
        1,
        False,
        ["a"],
        [False, False],
    )
