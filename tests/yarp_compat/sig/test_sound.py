"""Sounds: parts, loudness, markers, and generated sounds."""

from __future__ import annotations

import numpy as np
import pytest

import yarp_compat as yarp


@pytest.fixture
def sound() -> yarp.Sound:
    sound = yarp.Sound.of(np.array([[1, 2, 3, 4], [-8, 40, 0, 100]]), 10)
    sound.add_marker("from", 1)
    sound.add_marker("to", 2, 1)
    return sound


def test_parts_of_a_sound_are_extracted_and_replaced(sound: yarp.Sound) -> None:
    assert sound.subSound(1, 2).sound2VecNonInterleaved() == (2, 3, 40, 0)
    assert sound.subSound("from", "to").sound2VecInterleaved() == (2, 40, 3, 0)
    assert sound.subSound("nowhere", "to").getSamples() == 3
    assert sound.subSound(9, 2).getSamples() == 0
    assert sound.extractChannelAsSound(1).toString() == " -8 40 0 100\n"
    assert sound.getChannel(0).tolist() == [1, 2, 3, 4]
    assert sound.replaceChannel(0, sound.extractChannelAsSound(1))
    assert not sound.replaceChannel(0, sound)
    assert not sound.replaceChannel(2, sound.extractChannelAsSound(1))
    assert sound.getMarkersCount() == 0


def test_sounds_are_appended_and_overwritten(sound: yarp.Sound, caplog: pytest.LogCaptureFixture) -> None:
    part = sound.subSound(2, 2)
    sound += part
    assert sound.getSamples() == 6
    sound.overwrite(part, 5)
    sound.overwrite(part, 0, 1)
    assert sound.toString() == " 3 2 3 4 3 3\n 0 40 0 100 0 0\n"
    sound += yarp.Sound.of(np.zeros((1, 3)), 10)
    assert sound.getSamples() == 6
    assert "channels or frequencies" in caplog.text


def test_sounds_are_amplified_and_normalized_by_their_peaks(sound: yarp.Sound) -> None:
    assert sound.findPeakInChannel(0) == (3, 4)
    assert sound.findPeak() == (1, 3, 100)
    sound.amplifyChannel(0, 2.5)
    assert sound.getChannel(0).tolist() == [2, 5, 7, 10]
    sound.normalize()
    assert sound.findPeak() == (1, 3, 32767)
    sound.amplify(-2)
    assert sound.get(3, 1) == -32768  # clipped to the range of two bytes
    assert sound.zeroChannel(1)
    assert not sound.zeroChannel(2)
    assert sound.getChannel(1).tolist() == [0, 0, 0, 0]
    sound.zero()
    sound.normalize()
    assert sound.findPeak() == (0, 0, 0)


def test_markers_and_times_refer_to_samples(sound: yarp.Sound) -> None:
    assert sound.get_marker("to") == (True, 2, 1)
    assert sound.getMarker(0).label == "from"
    sound.remove_marker("to")
    assert sound.get_marker("to") == (False, 0, -1)
    assert (sound.sample2timestamp(25), sound.timestamp2sample(0.25)) == (2.0, 2)
    assert sound.isEqual(sound)


def test_tones_and_waves_have_the_samples_of_yarp(caplog: pytest.LogCaptureFixture) -> None:
    sound = yarp.Sound()
    assert yarp.makeTone(sound, 0.01, 2, 8000, 1000, 1000)
    assert sound.sound2VecNonInterleaved()[:9] == (0, 707, 1000, 707, 0, -707, -1000, -707, 0)
    assert (sound.getChannels(), sound.getSamples()) == (2, 80)
    assert yarp.makeSquareWave(sound, 1.0, 1, 8, 1, 100)
    samples = sound.sound2VecNonInterleaved()
    assert (samples[1:4], samples[5:]) == ((100, 100, 100), (-100, -100, -100))
    assert yarp.makeSawTooth(sound, 1.0, 1, 4, 1, 100)
    assert sound.sound2VecNonInterleaved() == (0, 50, -100, -50)
    assert not yarp.makeTone(sound, 0.0)
    assert "cannot generate" in caplog.text


def test_two_sounds_are_mixed() -> None:
    first, other = yarp.Sound.of(np.array([100, -100, 50]), 8), yarp.Sound.of(np.array([10]), 8)
    assert yarp.mix(first, other, 0.7).sound2VecNonInterleaved() == (73, -70, 35)
    assert yarp.mix(first, yarp.Sound.of(np.array([10]), 9)).getSamples() == 0
