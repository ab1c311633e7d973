"""Sounds: parts, loudness, markers, and sounds that are made."""

from __future__ import annotations

import numpy as np
import pytest

import yarp_compat as yarp


@pytest.fixture
def sound() -> yarp.Sound:
    made = yarp.Sound.of(np.array([[1, 2, 3, 4], [-8, 40, 0, 100]]), 10)
    made.add_marker("from", 1)
    made.add_marker("to", 2, 1)
    return made


def test_parts(sound: yarp.Sound) -> None:
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


def test_one_behind_and_over_another(sound: yarp.Sound, caplog: pytest.LogCaptureFixture) -> None:
    part = sound.subSound(2, 2)
    sound += part
    assert sound.getSamples() == 6
    sound.overwrite(part, 5)
    sound.overwrite(part, 0, 1)
    assert sound.toString() == " 3 2 3 4 3 3\n 0 40 0 100 0 0\n"
    sound += yarp.Sound.of(np.zeros((1, 3)), 10)
    assert sound.getSamples() == 6
    assert "channels or frequencies" in caplog.text


def test_loudness(sound: yarp.Sound) -> None:
    assert sound.findPeakInChannel(0) == (3, 4)
    assert sound.findPeak() == (1, 3, 100)
    sound.amplifyChannel(0, 2.5)
    assert sound.getChannel(0).tolist() == [2, 5, 7, 10]
    sound.normalize()
    assert sound.findPeak() == (1, 3, 32767)
    sound.amplify(-2)
    assert sound.get(3, 1) == -32768  # as loud as two bytes can say
    assert sound.zeroChannel(1)
    assert not sound.zeroChannel(2)
    assert sound.getChannel(1).tolist() == [0, 0, 0, 0]
    sound.zero()
    sound.normalize()
    assert sound.findPeak() == (0, 0, 0)


def test_markers_and_times(sound: yarp.Sound) -> None:
    assert sound.get_marker("to") == (True, 2, 1)
    assert sound.getMarker(0).label == "from"
    sound.remove_marker("to")
    assert sound.get_marker("to") == (False, 0, -1)
    assert (sound.sample2timestamp(25), sound.timestamp2sample(0.25)) == (2.0, 2)
    assert sound.isEqual(sound)


def test_sounds_that_are_made(caplog: pytest.LogCaptureFixture) -> None:
    made = yarp.Sound()
    assert yarp.makeTone(made, 0.01, 2, 8000, 1000, 1000)
    assert made.sound2VecNonInterleaved()[:9] == (0, 707, 1000, 707, 0, -707, -1000, -707, 0)
    assert (made.getChannels(), made.getSamples()) == (2, 80)
    assert yarp.makeSquareWave(made, 1.0, 1, 8, 1, 100)
    found = made.sound2VecNonInterleaved()
    assert (found[1:4], found[5:]) == ((100, 100, 100), (-100, -100, -100))
    assert yarp.makeSawTooth(made, 1.0, 1, 4, 1, 100)
    assert made.sound2VecNonInterleaved() == (0, 50, -100, -50)
    assert not yarp.makeTone(made, 0.0)
    assert "cannot generate" in caplog.text


def test_two_at_once() -> None:
    one, other = yarp.Sound.of(np.array([100, -100, 50]), 8), yarp.Sound.of(np.array([10]), 8)
    assert yarp.mix(one, other, 0.7).sound2VecNonInterleaved() == (73, -70, 35)
    assert yarp.mix(one, yarp.Sound.of(np.array([10]), 9)).getSamples() == 0
