"""Generated sounds, and the mix of two: `yarp/sig/SoundUtils.h` of 4.0."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yarp_compat.sig.sound import Sound

log = logging.getLogger("yarp.sig.SoundUtils")

Wave = Callable[[NDArray[Any]], NDArray[Any]]


def makeTone(
    outSound: Sound,
    duration_s: float = 1.0,
    channels: int = 1,
    sampleRate: int = 16000,
    frequency: float = 440.0,
    amplitude: int = 30000,
) -> bool:
    """Fill ``outSound`` with a sine wave; return False unless all numbers except the frequency are positive."""
    return _generate(outSound, duration_s, channels, sampleRate, amplitude, lambda t: np.sin(2 * np.pi * frequency * t))


def makeSquareWave(
    outSound: Sound,
    duration_s: float = 1.0,
    channels: int = 1,
    sampleRate: int = 16000,
    frequency: float = 1.0,
    amplitude: int = 30000,
) -> bool:
    """Fill ``outSound`` with a square wave; for the arguments, see `makeTone`."""

    def wave(t: NDArray[Any]) -> NDArray[Any]:
        return np.where(np.sin(2 * np.pi * frequency * t) >= 0, 1.0, -1.0)

    return _generate(outSound, duration_s, channels, sampleRate, amplitude, wave)


def makeSawTooth(
    outSound: Sound,
    duration_s: float = 1.0,
    channels: int = 1,
    sampleRate: int = 16000,
    frequency: float = 1.0,
    amplitude: int = 30000,
) -> bool:
    """Fill ``outSound`` with a sawtooth wave; for the arguments, see `makeTone`."""

    def wave(t: NDArray[Any]) -> NDArray[Any]:
        return 2 * (t * frequency - np.floor(t * frequency + 0.5))

    return _generate(outSound, duration_s, channels, sampleRate, amplitude, wave)


def mix(A: Sound, B: Sound, percentage: float = 0.5) -> Sound:
    """Mix two sounds, the first with the weight ``percentage``; return an empty sound if their formats differ."""
    if (A.getFrequency(), A.getChannels()) != (B.getFrequency(), B.getChannels()):
        log.error("cannot mix %r and %r: their channels or frequencies differ", A, B)
        return Sound()
    part = min(max(percentage, 0.0), 1.0)
    both = np.zeros((A.getChannels(), max(A.getSamples(), B.getSamples())))
    both[:, : A.getSamples()] += part * A.numpy()
    both[:, : B.getSamples()] += (1.0 - part) * B.numpy()
    return Sound.of(np.trunc(both).astype("<i2"), A.getFrequency())


def _generate(sound: Sound, seconds: float, channels: int, rate: int, amplitude: int, wave: Wave) -> bool:
    if min(seconds, channels, rate, amplitude) <= 0:
        text = "cannot generate a sound of %s s, %s channels, %s Hz and the amplitude %s"
        log.error(text, seconds, channels, rate, amplitude)
        return False
    channel = np.trunc(amplitude * wave(np.arange(int(rate * seconds)) / rate)).astype("<i2")
    sound._become(Sound.of(np.tile(channel, (channels, 1)), rate))
    return True
