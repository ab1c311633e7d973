"""The names of `import yarp_compat as yarp`, and the errors for missing ones."""

from __future__ import annotations

import pickle
import subprocess
import sys

import pytest

import yarp_compat as yarp
from yarp_compat import catalog


@pytest.mark.parametrize("name", catalog.names())
def test_every_name_exists(name: str) -> None:
    assert getattr(yarp, name) is not None
    assert name in dir(yarp)


def test_names_are_loaded_on_first_use_without_numpy() -> None:
    code = (
        "import sys, yarp_compat as yarp\n"
        "first = ('yarp_compat.catalog', 'yarp_compat.absences')\n"
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
def test_a_missing_name_has_a_replacement_in_its_error(name: str, instead: str) -> None:
    with pytest.raises(AttributeError, match=instead):
        getattr(yarp, name)


def test_enumerators_are_names_of_the_module() -> None:
    assert yarp.navigation_status_moving is yarp.NavigationStatusEnum.navigation_status_moving
    assert yarp.localization_status_localized_ok is yarp.LocalizationStatusEnum.localization_status_localized_ok
    assert yarp.local_map is yarp.NavigationMapTypeEnum.local_map
    assert yarp.global_trajectory is yarp.TrajectoryTypeEnum.global_trajectory
    with pytest.raises(AttributeError):
        _ = yarp.navigation_status_nonsense


def test_families_of_classes_are_made_on_first_use() -> None:
    assert issubclass(yarp.BufferedPortImageRgb, yarp.BufferedPort)
    assert yarp.BufferedPortImageRgb is yarp.BufferedPortImageRgb
    assert yarp.BufferedPortBottle().prepare().size() == 0
    assert yarp.Network_exists is yarp.Network.exists
    with pytest.raises(TypeError, match="BufferedPort"):
        yarp.BufferedPort()


def test_classes_of_families_inherit_as_in_the_bindings() -> None:
    assert issubclass(yarp.BufferedPortImageRgb, yarp.TypedReaderImageRgb)
    assert yarp.TypedReaderCallbackSound is yarp.SoundCallback
    assert issubclass(yarp.TypedReaderCallbackVectorInt, yarp.TypedReaderCallback)
    assert pickle.loads(pickle.dumps(yarp.BufferedPortBottle)) is yarp.BufferedPortBottle


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("YARP_FEATURE_ZOOM", 16),
        ("cameraFeature_id_t_YARP_FEATURE_GAIN", 8),
        ("FeatureMode_MODE_AUTO", 2),
        ("MAS_WAITING_FOR_FIRST_READ", 4),
        ("VOCAB_NAV_GOTOABS", 0x73626173),
        ("VOCAB_PID", 0x646970),
        ("BOTTLE_TAG_FLOAT64", 10),
        ("BOTTLE_TAG_LIST", 256),
        ("VOCAB_PIXEL_RGB", 0x626772),
        ("PeriodicThreadClock_Absolute", 1),
        ("YARP_VERSION_MAJOR", 4),
    ],
)
def test_constants_have_the_values_of_yarp(name: str, value: int) -> None:
    """The values are those of the headers of 3.9.1 and 4.0.0."""
    assert getattr(yarp, name) == value


def test_vocabs_are_made_of_characters() -> None:
    assert yarp.createVocab("p", "o", "s") == yarp.createVocab32("p", "o", "s") == yarp.encode("pos")
    assert yarp.createVocab64(*"position") == yarp.encode64("position")
    assert yarp.decode64(yarp.encode64("position")) == "position"


def test_a_star_import_imports_every_name() -> None:
    names: dict[str, object] = {}
    exec("from yarp_compat import *", names)
    wanted = "Bottle BufferedPortBottle SoundCallback TypedReaderCallbackSound delay VOCAB_PIXEL_RGB local_map"
    assert not set(wanted.split()) - set(names)
    assert not [name for name in names if name.startswith("_") and name != "__builtins__"]


def test_a_star_import_without_numpy_leaves_out_names_that_need_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    names = catalog.everything()
    assert "Bottle" in names
    assert "Vector" not in names
    code = (
        "import sys; sys.modules['numpy'] = None; import yarp_compat; [getattr(yarp_compat, n) for n in sys.argv[1:]]"
    )
    subprocess.run([sys.executable, "-c", code, *names], check=True)


def test_classes_have_the_bases_of_the_bindings() -> None:
    bottle = yarp.Bottle("1 2")
    for base in (yarp.Portable, yarp.Searchable, yarp.PortReader, yarp.PortWriter):
        assert isinstance(bottle, base)
    assert isinstance(yarp.ResourceFinder(), yarp.Searchable)
    assert isinstance(yarp.RpcClient(), yarp.UnbufferedContactable)
    assert isinstance(yarp.BufferedPortBottle(), yarp.Contactable)
    other = yarp.Bottle()
    assert yarp.Portable.copyPortable(bottle, other)
    assert other == bottle
    assert not yarp.Portable.copyPortable(bottle, yarp.ImageRgb())
    assert (yarp.ImageRgb().getType().getName(), yarp.Bottle().getReadType().toString()) == ("yarp/image", "null")


@pytest.mark.parametrize(
    "name", ["Bottle", "Property", "RFModule", "PortReader", "BottleCallback", "BufferedPortBottle", "Vector", "Thread"]
)
def test_a_mix_in_may_have_its_own_metaclass(name: str) -> None:
    """Classes of Qt's bindings have one."""

    class Meta(type):
        pass

    class MixIn(metaclass=Meta):
        pass

    combined = Meta("Combined", (getattr(yarp, name), MixIn), {})
    assert issubclass(combined, getattr(yarp, name))


def test_std_vectors_grow_and_shrink() -> None:
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


def test_std_vectors_have_the_methods_of_cpp() -> None:
    vector = yarp.DVector([1.0, 2.0, 3.0])
    assert (vector.front(), vector.back(), vector.capacity() >= 3, list(vector.iterator())) == (1.0, 3.0, True, vector)
    vector.pop_back()
    other = yarp.DVector()
    other.assign(2, 7.0)
    vector.swap(other)
    assert (vector, other) == ([7.0, 7.0], [1.0, 2.0])
    places = yarp.Map2DLocationVector(2)
    places[0].x = 1.0
    assert (places[0].x, places[1].x) == (1.0, 0.0)
    talk = yarp.LLMVector()
    talk.push_back(yarp.LLM_Message("user", "hello"))
    assert talk[0].toString() == "user hello () ()"
