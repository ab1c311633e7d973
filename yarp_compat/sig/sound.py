"""Sounds (`yarp/sig/Sound.h`): samples of two bytes, one channel after another.

The bytes changed with nearly every release, and only the length of the outer list tells which they are:

======  ==============================================================================
4.0     list of 6: samples, channels, bytes per sample, frequency, the samples, the markers (whose fields have no tags)
3.10 on list of 5: the same without markers
3.9     "list of 4": the same with samples that have no header, and a tag of 0 before the first number
======  ==============================================================================

All are read; YARP 4 is written the first, YARP 3 the second. Before 3.9 a sound was a pair of an image and a Bottle,
which this does not know. Real YARP spoils sounds of one byte per sample on the wire; this refuses them.
"""

from __future__ import annotations

import logging
import struct
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from yarp_compat.sig.vector import Comparable, write_numbers
from yarp_compat.wire.accessors import always, getter, setter
from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.tags import INT16, LIST

_SAMPLE = np.dtype("<i2")
_FIELDS = struct.Struct("<8i")
_LIST = struct.Struct("<ii")
_PLACE = struct.Struct("<iq")
_LENGTH = struct.Struct("<i")
_LARGEST = 2**31 - 1
_LOUDEST = 2**15 - 1  # the greatest sample

log = logging.getLogger("yarp.sig.Sound")


@dataclass(frozen=True, slots=True)
class SoundMarker:
    """A named place in a sound: a channel, or -1, and a sample."""

    label: str = ""
    channel: int = -1
    sample_id: int = 0


class Sound(Comparable, Portable):
    """A sound."""

    def __init__(self, bytesPerSample: int = 2) -> None:
        if bytesPerSample != 2:
            raise ValueError(f"sounds have 2 bytes per sample, not {bytesPerSample}")
        self._samples: NDArray[Any] = np.zeros((1, 0), _SAMPLE)
        self._frequency = 0
        self._markers: dict[str, SoundMarker] = {}

    @classmethod
    def of(cls, samples: NDArray[Any], frequency: int) -> Self:
        """A sound of an int16 array (channels, samples), which it shares where that is in one piece."""
        sound = cls()
        sound._samples = np.ascontiguousarray(np.atleast_2d(samples), _SAMPLE)
        sound._frequency = frequency
        return sound

    def numpy(self) -> NDArray[Any]:
        """The samples as an array (channels, samples) in the sound's memory."""
        return self._samples

    def resize(self, samples: int, channels: int = 1) -> None:
        """Become of this size, silent."""
        self._samples = np.zeros((channels, samples), _SAMPLE)

    def clear(self) -> None:
        """Become empty."""
        self._samples = np.zeros((0, 0), _SAMPLE)
        self._markers, self._frequency = {}, 0

    def get(self, sample: int, channel: int = 0) -> int:
        """One sample."""
        return int(self._samples[channel, sample])

    def set(self, value: int, sample: int, channel: int = 0) -> None:
        """Change one sample."""
        self._own()[channel, sample] = value

    def isSample(self, sample: int, channel: int = 0) -> bool:
        """Whether there is such a sample."""
        return 0 <= channel < self.getChannels() and 0 <= sample < self.getSamples()

    def getSafe(self, sample: int, channel: int = 0) -> int:
        """One sample, or 0 where none exists."""
        return self.get(sample, channel) if self.isSample(sample, channel) else 0

    def setSafe(self, value: int, sample: int, channel: int = 0) -> None:
        """Change one sample, if there is such."""
        if self.isSample(sample, channel):
            self.set(value, sample, channel)

    getFrequency = getter("_frequency", int, "Samples per second.")
    setFrequency = setter("_frequency", int, "Change how many samples there are in a second.")
    getBytesPerSample = always(2, "Bytes of a sample.")

    def getSamples(self) -> int:
        """Samples in a channel."""
        return int(self._samples.shape[1])

    def getChannels(self) -> int:
        """The number of channels."""
        return int(self._samples.shape[0])

    def getDuration(self) -> float:
        """Seconds."""
        return self.getSamples() / self._frequency if self._frequency else 0.0

    def sample2timestamp(self, sampleid: int) -> float:
        """The time of a sample in whole seconds, as YARP divides."""
        return float(sampleid // self._frequency) if self._frequency else 0.0

    def timestamp2sample(self, time: float) -> int:
        """The sample at a time, in seconds."""
        return int(time * self._frequency)

    # parts of it

    def subSound(self, first: int | str, length: int | str) -> Self:
        """So many samples from one on, as of 4.0 (3.x has the last one there), or those from one marker to another."""
        if isinstance(first, str) or isinstance(length, str):
            begin = self._place(first, 0)
            first, length = begin, self._place(length, self.getSamples() - 1) - begin + 1
        return type(self).of(self._samples[:, first : first + max(length, 0)].copy(), self._frequency)

    def extractChannelAsSound(self, channel_id: int) -> Self:
        """One channel as a sound."""
        return type(self).of(self._samples[channel_id].copy(), self._frequency)

    def getChannel(self, channel_id: int) -> NDArray[Any]:
        """The samples of one channel, in the sound's memory."""
        samples: NDArray[Any] = self._samples[channel_id]
        return samples

    def replaceChannel(self, id: int, schannel: Sound) -> bool:  # noqa: A002 - YARP's name
        """Change a channel to that of another sound; False where that has several, or is of another length."""
        if schannel.getChannels() != 1 or schannel.getSamples() != self.getSamples() or not self.isChannel(id):
            return False
        self._own()[id] = schannel.numpy()[0]
        self._markers = {}
        return True

    def overwrite(self, alt: Sound, offset: int = 0, len: int = 0) -> None:  # noqa: A002 - YARP's name
        """Change samples from one on to another sound's, as many as fit (``len``: at most so many)."""
        if not self._alike(alt):
            return
        count = min(len or alt.getSamples(), alt.getSamples(), max(self.getSamples() - offset, 0))
        self._own()[:, offset : offset + count] = alt.numpy()[:, :count]
        self._markers = {}

    def __iadd__(self, alt: Sound) -> Self:
        if self._alike(alt):
            self._samples = np.ascontiguousarray(np.concatenate([self._samples, alt.numpy()], axis=1))
        return self

    # loudness

    def zero(self) -> None:
        """Become silent."""
        self._own()[:] = 0

    def zeroChannel(self, chan: int) -> bool:
        """Silence a channel; False where there is no such."""
        if not self.isChannel(chan):
            return False
        self._own()[chan] = 0
        self._markers = {}
        return True

    clearChannel = zeroChannel  # 3.x's name

    def isChannel(self, channel: int) -> bool:
        """Whether there is such a channel."""
        return 0 <= channel < self.getChannels()

    def amplify(self, gain: float) -> None:
        """Make it louder or quieter; what is too loud for two bytes is as loud as they can say, where YARP wraps."""
        for channel in range(self.getChannels()):
            self.amplifyChannel(channel, gain)

    def amplifyChannel(self, channel: int, gain: float) -> None:
        """Make one channel louder or quieter, see `amplify`."""
        samples = self._own()
        samples[channel] = np.clip(np.trunc(samples[channel] * float(gain)), -_LOUDEST - 1, _LOUDEST)

    def normalize(self) -> None:
        """Make it so loud that its greatest sample is the greatest there is; silence stays."""
        _, _, peak = self.findPeak()
        if peak > 0:
            self.amplify(_LOUDEST / peak)

    def normalizeChannel(self, channel: int) -> None:
        """The same for one channel."""
        _, peak = self.findPeakInChannel(channel)
        if peak > 0:
            self.amplifyChannel(channel, _LOUDEST / peak)

    def findPeakInChannel(self, channelId: int) -> tuple[int, int]:
        """The sample of a channel that is the greatest above 0, and its value; 0, 0 where none is."""
        samples = self._samples[channelId]
        at = int(samples.argmax()) if samples.size else 0
        return (at, int(samples[at])) if samples.size and samples[at] > 0 else (0, 0)

    def findPeak(self) -> tuple[int, int, int]:
        """The channel, the sample and the value of the greatest above 0; 0, 0, 0 where none is."""
        peaks = [(channel, *self.findPeakInChannel(channel)) for channel in range(self.getChannels())]
        return max(peaks, key=lambda peak: peak[2], default=(0, 0, 0))

    def toString(self) -> str:
        """The samples, a line for each channel."""
        return "".join("".join(f" {value}" for value in row) + "\n" for row in self._samples.tolist())

    toString_c = toString

    getRawDataSize = getter("_samples.nbytes", int, "Bytes of all samples.")

    def sound2VecNonInterleaved(self) -> tuple[int, ...]:
        """All samples, channel after channel."""
        return tuple(self._samples.reshape(-1).tolist())

    def sound2VecInterleaved(self) -> tuple[int, ...]:
        """All samples, those of one moment together."""
        return tuple(self._samples.T.reshape(-1).tolist())

    getNonInterleavedAudioRawData = sound2VecNonInterleaved
    getInterleavedAudioRawData = sound2VecInterleaved

    def vecNonInterleaved2Sound(self, values: list[int], samples: int, channels: int) -> None:
        """Become these samples, given channel after channel."""
        self._samples = np.array(values, _SAMPLE).reshape(channels, samples)

    def vecInterleaved2Sound(self, values: list[int], samples: int, channels: int) -> None:
        """Become these samples, given with those of one moment together."""
        self._samples = np.ascontiguousarray(np.array(values, _SAMPLE).reshape(samples, channels).T)

    def add_marker(self, label: str, sample_id: int, channel: int = -1) -> None:
        """Name a place."""
        self._markers[label] = SoundMarker(label, channel, sample_id)

    def getMarkers(self) -> list[SoundMarker]:
        """All named places, by name."""
        return [self._markers[label] for label in sorted(self._markers)]

    def getMarker(self, index: int) -> SoundMarker:
        """One of the named places, by name."""
        return self.getMarkers()[index]

    def get_marker(self, marker_label: str) -> tuple[bool, int, int]:
        """Whether there is such a place, its sample, and its channel or -1."""
        marker = self._markers.get(marker_label)
        return (False, 0, -1) if marker is None else (True, marker.sample_id, marker.channel)

    def remove_marker(self, marker_label: str) -> None:
        """Forget one of the named places."""
        self._markers.pop(marker_label, None)

    def getMarkersCount(self) -> int:
        """The number of them."""
        return len(self._markers)

    def remove_all_markers(self) -> None:
        """Forget the named places."""
        self._markers = {}

    def _own(self) -> NDArray[Any]:
        """The samples in memory that can be changed."""
        if not self._samples.flags.writeable:
            self._samples = self._samples.copy()
        return self._samples

    def _alike(self, other: Sound) -> bool:
        """Whether both have as many channels, and as many samples in a second; says in the log what differs."""
        alike = (self.getChannels(), self._frequency) == (other.getChannels(), other._frequency)
        if not alike:
            log.error("%r and %r are of another number of channels or rate", self, other)
        return alike

    def _place(self, marker: int | str, default: int) -> int:
        """The sample of a marker."""
        if isinstance(marker, int):
            return marker
        found, sample, _ = self.get_marker(marker)
        if not found:
            log.warning("there is no marker %s", marker)
        return sample if found else default

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Sound):
            return NotImplemented
        same = (self._frequency, self._markers) == (other._frequency, other._markers)
        return same and np.array_equal(self._samples, other._samples)

    def __repr__(self) -> str:
        return f"<Sound of {self.getSamples()} samples in {self.getChannels()} channels at {self._frequency} Hz>"

    def _write(self, out: ElementWriter) -> None:
        newest = out.profile is Profile.YARP4
        out.begin(6 if newest else 5)
        for number in (self.getSamples(), self.getChannels(), 2, self._frequency):
            out.integer(number)
        write_numbers(out, self._samples.reshape(-1))
        if newest:
            out.begin(len(self._markers))
            for marker in self.getMarkers():
                out.begin(4)
                out.string(marker.label, tagged=False)
                out.string(marker.label, tagged=False)
                out.raw(_PLACE, marker.channel, marker.sample_id)

    def _read(self, source: ElementReader) -> None:
        parts = source.begin()
        if parts not in (4, 5, 6):
            raise WireError(f"a sound has 4, 5 or 6 parts, not {parts}")
        _, samples, _, channels, _, size, _, frequency = source.raw(_FIELDS)
        if size != 2:
            raise WireError(f"sounds have 2 bytes per sample, not {size}")
        if min(samples, channels) < 0 or samples * channels > _LARGEST:
            raise WireError(f"a sound of {samples} samples in {channels} channels")
        if parts > 4:
            code, count = source.raw(_LIST)
            if code != LIST | INT16 or count != samples * channels:
                raise WireError(f"{samples} samples in {channels} channels are not a list of {count} of tag {code}")
        values = np.frombuffer(source.block(2 * samples * channels), _SAMPLE)
        markers = _markers(source) if parts == 6 else {}
        source.leave()
        self._samples, self._frequency, self._markers = values.reshape(channels, samples), frequency, markers


def _markers(source: ElementReader) -> dict[str, SoundMarker]:
    code, count = source.raw(_LIST)
    if code != LIST or count < 0:
        raise WireError(f"a sound's markers are a list, not {code} of {count}")
    markers = {}
    for _ in range(count):
        if source.raw(_LIST) != (LIST, 4):
            raise WireError(f"a sound's marker before byte {source.at} is no list of 4")
        key, label = _text(source), _text(source)
        markers[key] = SoundMarker(label, *source.raw(_PLACE))
    return markers


def _text(source: ElementReader) -> str:
    size = int(source.raw(_LENGTH)[0])
    if size < 0:
        raise WireError(f"a string of {size} bytes before byte {source.at}")
    return str(source.block(size), "utf-8", "surrogateescape")
