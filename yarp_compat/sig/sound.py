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

import struct
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from yarp_compat.sig.vector import write_numbers
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


@dataclass(frozen=True, slots=True)
class SoundMarker:
    """A named place in a sound: a channel, or -1, and a sample."""

    label: str = ""
    channel: int = -1
    sample_id: int = 0


class Sound(Portable):
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
        if not self._samples.flags.writeable:
            self._samples = self._samples.copy()
        self._samples[channel, sample] = value

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

    getRawDataSize = getter("_samples.nbytes", int, "Bytes of all samples.")

    def sound2VecNonInterleaved(self) -> list[int]:
        """All samples, channel after channel."""
        return [int(value) for value in self._samples.reshape(-1)]

    def sound2VecInterleaved(self) -> list[int]:
        """All samples, those of one moment together."""
        return [int(value) for value in self._samples.T.reshape(-1)]

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

    def getMarkersCount(self) -> int:
        """The number of them."""
        return len(self._markers)

    def remove_all_markers(self) -> None:
        """Forget the named places."""
        self._markers = {}

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
