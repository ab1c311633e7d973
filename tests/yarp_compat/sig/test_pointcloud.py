"""Point clouds and sounds. The layouts are those of YARP's sources, as no real bytes were recorded."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from yarp_compat.sig.pointcloud import LAYOUTS, PointCloud, PointCloudXYZ, PointCloudXYZI, PointCloudXYZRGBA, PointType
from yarp_compat.sig.sound import Sound
from yarp_compat.wire import binary
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.profile import Profile

POINT = bytes.fromhex("0000803f 00000040 00004040 00000000")


@pytest.mark.parametrize(("profile", "tag"), [(Profile.YARP3, "0a010000"), (Profile.YARP4, "14010000")])
def test_a_cloud_has_yarps_bytes(profile: Profile, tag: str) -> None:
    cloud = PointCloudXYZ()
    cloud.push_back((1, 2, 3))
    data = bytes.fromhex("01000000 01000000 02000000 01" + tag + "01000000") + POINT
    assert cloud.to_bytes(profile) == data
    assert PointCloud.from_bytes(data) == cloud
    assert cloud.wireSizeBytes() == 13 + 16


@given(st.sampled_from(PointType), st.integers(0, 5), st.integers(1, 3), st.sampled_from(Profile), st.booleans())
def test_every_point_type_survives_the_round_trip(
    kind: PointType, width: int, height: int, profile: Profile, dense: bool
) -> None:
    points = np.zeros((height, width), LAYOUTS[kind])
    for place, name in enumerate(points.dtype.names or ()):
        points[name] = place + 1
    cloud = PointCloud.of(points, dense=dense)
    again = PointCloud.from_bytes(cloud.to_bytes(profile))
    assert again == cloud
    assert (again.width(), again.height(), again.getPointType(), again.isDense()) == (width, height, kind, dense)
    assert again.isOrganized() is (height > 1)
    assert again.numpy().tolist() == points.reshape(-1).tolist()


def test_points_of_another_type_are_converted() -> None:
    cloud = PointCloudXYZRGBA()
    cloud.push_back((1, 2, 3, 10, 20, 30, 40))
    assert cloud[0]["r"] == 30
    other = PointCloudXYZI.from_bytes(cloud.to_bytes())
    assert other.numpy().tolist() == [(1, 2, 3, 0)]
    assert PointCloud.from_bytes(cloud.to_bytes())[0]["a"] == 40


def test_memory_of_a_cloud_is_shared() -> None:
    points = np.zeros(4, LAYOUTS[PointType.XYZ])
    cloud = PointCloudXYZ.of(points)
    assert np.shares_memory(cloud.numpy(), points)
    assert np.shares_memory(np.frombuffer(cloud.bytes_of_points(), np.uint8), points)
    cloud.resize(2)
    assert (cloud.size(), cloud.dataSizeBytes()) == (2, 32)
    cloud.clear()
    assert (cloud.size(), cloud.width(), cloud.height()) == (0, 0, 0)
    with pytest.raises(ValueError, match="points of"):
        PointCloudXYZ.of(np.zeros(4, LAYOUTS[PointType.XY]))


@pytest.mark.parametrize(
    ("place", "value"), [(0, 2), (0, -1), (4, 2**31 - 1), (8, 4), (13, 0x114), (17, 2), (17, 2**31 - 1), (17, -1)]
)
def test_inconsistent_clouds_are_refused(place: int, value: int) -> None:
    data = bytearray(bytes.fromhex("01000000 01000000 02000000 01 0a010000 01000000") + POINT)
    data[place : place + 4] = value.to_bytes(4, "little", signed=True)
    with pytest.raises(WireError):
        PointCloud.from_bytes(data, Profile.YARP3)


def tone() -> Sound:
    sound = Sound()
    sound.resize(3, 2)
    sound.setFrequency(44100)
    for channel in range(2):
        for sample in range(3):
            sound.set(-10 * channel + sample, sample, channel)
    return sound


SAMPLES = "000001000200f6fff7fff8ff"
NUMBERS = "0100000003000000 0100000002000000 0100000002000000 0100000044ac0000"


def test_a_sound_has_the_bytes_of_3_10_and_later() -> None:
    data = bytes.fromhex("0001000005000000" + NUMBERS + "4001000006000000" + SAMPLES)
    assert tone().to_bytes(Profile.YARP3) == data
    assert Sound.from_bytes(data) == tone()
    assert binary.decode(data, Profile.YARP3) == [3, 2, 2, 44100, [0, 1, 2, -10, -9, -8]]


def test_sound_of_4_0_has_markers() -> None:
    sound = tone()
    data = bytes.fromhex("0001000006000000" + NUMBERS + "4001000006000000" + SAMPLES + "00010000")
    assert sound.to_bytes(Profile.YARP4) == data + bytes(4)
    sound.add_marker("go", 2, 1)
    marker = "0001000004000000 02000000676f 02000000676f 01000000 0200000000000000"
    assert sound.to_bytes(Profile.YARP4) == data + bytes.fromhex("01000000" + marker)
    again = Sound.from_bytes(sound.to_bytes(Profile.YARP4))
    assert again == sound
    assert [(marker.label, marker.channel, marker.sample_id) for marker in again.getMarkers()] == [("go", 1, 2)]


def test_sound_of_3_9_is_read() -> None:
    data = bytes.fromhex("0001000004000000 00000000" + NUMBERS[8:] + SAMPLES)
    assert Sound.from_bytes(data) == tone()


@pytest.mark.parametrize("profile", Profile)
def test_truncated_and_inconsistent_sounds_are_refused(profile: Profile) -> None:
    sound = tone()
    sound.add_marker("go", 2)
    data = sound.to_bytes(profile)
    for size in range(len(data)):
        with pytest.raises(WireError):
            Sound.from_bytes(data[:size], profile)
    for place, value in [(12, 2**31 - 1), (20, 2**31 - 1), (20, -1), (28, 1), (44, 5), (4, 7)]:
        bad = bytearray(data)
        bad[place : place + 4] = value.to_bytes(4, "little", signed=True)
        with pytest.raises(WireError):
            Sound.from_bytes(bad, profile)


def test_sound_methods_work_as_in_yarp() -> None:
    sound = tone()
    assert (sound.getSamples(), sound.getChannels(), sound.getBytesPerSample(), sound.getFrequency()) == (
        3,
        2,
        2,
        44100,
    )
    assert sound.getDuration() == pytest.approx(3 / 44100)
    assert sound.sound2VecNonInterleaved() == (0, 1, 2, -10, -9, -8)
    assert sound.sound2VecInterleaved() == (0, -10, 1, -9, 2, -8)
    other = Sound()
    other.vecInterleaved2Sound(sound.sound2VecInterleaved(), 3, 2)
    other.setFrequency(44100)
    assert other == sound
    assert (sound.getSafe(9, 9), sound.getSafe(2, 1), sound.isSample(3, 0)) == (0, -8, False)
    sound.setSafe(5, 9, 9)
    read = Sound.from_bytes(sound.to_bytes())
    read.set(77, 0)
    assert (read.get(0), sound.get(0)) == (77, 0)
    samples = np.arange(6, dtype=np.int16).reshape(2, 3)
    assert np.shares_memory(Sound.of(samples, 8000).numpy(), samples)
    sound.clear()
    assert (sound.getSamples(), sound.getChannels()) == (0, 0)
