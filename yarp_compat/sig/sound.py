"""Sounds (`yarp/sig/Sound.h`): samples of two bytes, channel by channel.

The format changed with nearly every release; the length of the outer list identifies it:

======  ==============================================================================
4.0     list of 6: samples, channels, bytes per sample, frequency, the samples, the markers (whose fields have no tags)
3.10 on list of 5: the same without markers
3.9     "list of 4": the same, but the samples have no header, and a tag of 0 is before the first number
======  ==============================================================================

This module reads all of them; it sends the first to YARP 4 peers, and the second to YARP 3 peers. Before 3.9 a sound
was a pair of an image and a Bottle, which is not supported. C++ YARP corrupts sounds of one byte per sample on the
wire; this module rejects them.
"""

from __future__ import annotations

import logging
import struct
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from yarp_compat.overriding import override
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
_LOUDEST = 2**15 - 1  # the largest sample

log = logging.getLogger("yarp.sig.Sound")


@dataclass(frozen=True, slots=True)
class SoundMarker:
    """A named position in a sound: a channel, or -1, and a sample."""

    label: str = ""
    channel: int = -1
    sample_id: int = 0


class Sound(Comparable, Portable):
    """A sound with channels of 16-bit samples."""

    def __init__(self, bytesPerSample: int = 2) -> None:
        if bytesPerSample != 2:
            raise ValueError(f"sounds have 2 bytes per sample, not {bytesPerSample}")
        self._samples: NDArray[Any] = np.zeros((1, 0), _SAMPLE)
        self._frequency = 0
        self._markers: dict[str, SoundMarker] = {}

    @classmethod
    def of(cls, samples: NDArray[Any], frequency: int) -> Self:
        """Return a sound of an int16 array (channels, samples), shared if contiguous."""
        sound = cls()
        sound._samples = np.ascontiguousarray(np.atleast_2d(samples), _SAMPLE)
        sound._frequency = frequency
        return sound

    def numpy(self) -> NDArray[Any]:
        """Return the samples (channels, samples) as a view of the sound's memory."""
        return self._samples

    def resize(self, samples: int, channels: int = 1) -> None:
        """Change the size and set all samples to 0."""
        self._samples = np.zeros((channels, samples), _SAMPLE)

    def clear(self) -> None:
        """Remove all samples, channels and markers, and set the frequency to 0."""
        self._samples = np.zeros((0, 0), _SAMPLE)
        self._markers, self._frequency = {}, 0

    def get(self, sample: int, channel: int = 0) -> int:
        """Return one sample."""
        return int(self._samples[channel, sample])

    def set(self, value: int, sample: int, channel: int = 0) -> None:
        """Set one sample."""
        self._writable()[channel, sample] = value

    def isSample(self, sample: int, channel: int = 0) -> bool:
        """Return whether the sample exists."""
        return 0 <= channel < self.getChannels() and 0 <= sample < self.getSamples()

    def getSafe(self, sample: int, channel: int = 0) -> int:
        """Return one sample, or 0 if it does not exist."""
        return self.get(sample, channel) if self.isSample(sample, channel) else 0

    def setSafe(self, value: int, sample: int, channel: int = 0) -> None:
        """Set one sample, if it exists."""
        if self.isSample(sample, channel):
            self.set(value, sample, channel)

    getFrequency = getter("_frequency", int, "The number of samples per second.")
    setFrequency = setter("_frequency", int, "Set the number of samples per second.")
    getBytesPerSample = always(2, "The size of a sample in bytes.")

    def getSamples(self) -> int:
        """Return the number of samples in a channel."""
        return int(self._samples.shape[1])

    def getChannels(self) -> int:
        """Return the number of channels."""
        return int(self._samples.shape[0])

    def getDuration(self) -> float:
        """Return the duration in seconds."""
        return self.getSamples() / self._frequency if self._frequency else 0.0

    def sample2timestamp(self, sampleid: int) -> float:
        """Return the time of a sample in whole seconds, rounded down as in YARP."""
        return float(sampleid // self._frequency) if self._frequency else 0.0

    def timestamp2sample(self, time: float) -> int:
        """Return the index of the sample at a time in seconds."""
        return int(time * self._frequency)

    # parts

    def subSound(self, first: int | str, length: int | str) -> Self:
        """Return ``length`` samples from ``first`` on, or the samples from one marker to another, both included.

        A missing marker stands for the first or last sample. YARP 3.x interprets the second argument as the end instead
        of the length.
        """
        if isinstance(first, str) or isinstance(length, str):
            begin = self._place(first, 0)
            first, length = begin, self._place(length, self.getSamples() - 1) - begin + 1
        return type(self).of(self._samples[:, first : first + max(length, 0)].copy(), self._frequency)

    def extractChannelAsSound(self, channel_id: int) -> Self:
        """Return one channel as a sound."""
        return type(self).of(self._samples[channel_id].copy(), self._frequency)

    def getChannel(self, channel_id: int) -> NDArray[Any]:
        """Return the samples of one channel, as a view of the sound's memory."""
        samples: NDArray[Any] = self._samples[channel_id]
        return samples

    def replaceChannel(self, id: int, schannel: Sound) -> bool:  # noqa: A002 - YARP's name
        """Replace a channel by another sound, and remove all markers.

        Return False if the channel does not exist, or the other sound is not one channel of the same length.
        """
        if schannel.getChannels() != 1 or schannel.getSamples() != self.getSamples() or not self.isChannel(id):
            return False
        self._writable()[id] = schannel.numpy()[0]
        self._markers = {}
        return True

    def overwrite(self, alt: Sound, offset: int = 0, len: int = 0) -> None:  # noqa: A002 - YARP's name
        """Replace samples from ``offset`` on by another sound's, and remove all markers.

        As many samples are replaced as fit, and at most ``len`` unless it is 0.
        """
        if not self._same_format(alt):
            return
        count = min(len or alt.getSamples(), alt.getSamples(), max(self.getSamples() - offset, 0))
        self._writable()[:, offset : offset + count] = alt.numpy()[:, :count]
        self._markers = {}

    def __iadd__(self, alt: Sound) -> Self:
        if self._same_format(alt):
            self._samples = np.ascontiguousarray(np.concatenate([self._samples, alt.numpy()], axis=1))
        return self

    # loudness

    def zero(self) -> None:
        """Set all samples to 0."""
        self._writable()[:] = 0

    def zeroChannel(self, chan: int) -> bool:
        """Set a channel's samples to 0, and remove all markers; return False if the channel does not exist."""
        if not self.isChannel(chan):
            return False
        self._writable()[chan] = 0
        self._markers = {}
        return True

    clearChannel = zeroChannel  # 3.x's name

    def isChannel(self, channel: int) -> bool:
        """Return whether the channel exists."""
        return 0 <= channel < self.getChannels()

    def amplify(self, gain: float) -> None:
        """Scale all samples; values out of range are clipped, while YARP lets them wrap around."""
        for channel in range(self.getChannels()):
            self.amplifyChannel(channel, gain)

    def amplifyChannel(self, channel: int, gain: float) -> None:
        """Scale one channel's samples like `amplify`."""
        samples = self._writable()
        samples[channel] = np.clip(np.trunc(samples[channel] * float(gain)), -_LOUDEST - 1, _LOUDEST)

    def normalize(self) -> None:
        """Scale the sound so that its largest sample has the largest value; without a sample above 0, do nothing."""
        _, _, peak = self.findPeak()
        if peak > 0:
            self.amplify(_LOUDEST / peak)

    def normalizeChannel(self, channel: int) -> None:
        """Scale one channel like `normalize`."""
        _, peak = self.findPeakInChannel(channel)
        if peak > 0:
            self.amplifyChannel(channel, _LOUDEST / peak)

    def findPeakInChannel(self, channelId: int) -> tuple[int, int]:
        """Return the index and value of a channel's largest sample above 0; 0, 0 if there is none."""
        samples = self._samples[channelId]
        at = int(samples.argmax()) if samples.size else 0
        return (at, int(samples[at])) if samples.size and samples[at] > 0 else (0, 0)

    def findPeak(self) -> tuple[int, int, int]:
        """Return the channel, index and value of the largest sample above 0; 0, 0, 0 if there is none."""
        peaks = [(channel, *self.findPeakInChannel(channel)) for channel in range(self.getChannels())]
        return max(peaks, key=lambda peak: peak[2], default=(0, 0, 0))

    def toString(self) -> str:
        """Return the samples as text, a line for each channel."""
        return "".join("".join(f" {value}" for value in row) + "\n" for row in self._samples.tolist())

    toString_c = toString

    getRawDataSize = getter("_samples.nbytes", int, "The size of all samples in bytes.")

    def sound2VecNonInterleaved(self) -> tuple[int, ...]:
        """Return all samples, channel by channel."""
        return tuple(self._samples.reshape(-1).tolist())

    def sound2VecInterleaved(self) -> tuple[int, ...]:
        """Return all samples, interleaved."""
        return tuple(self._samples.T.reshape(-1).tolist())

    getNonInterleavedAudioRawData = sound2VecNonInterleaved
    getInterleavedAudioRawData = sound2VecInterleaved

    def vecNonInterleaved2Sound(self, values: list[int], samples: int, channels: int) -> None:
        """Replace the samples by ``values``, which are ordered channel by channel."""
        self._samples = np.array(values, _SAMPLE).reshape(channels, samples)

    def vecInterleaved2Sound(self, values: list[int], samples: int, channels: int) -> None:
        """Replace the samples by ``values``, which are interleaved."""
        self._samples = np.ascontiguousarray(np.array(values, _SAMPLE).reshape(samples, channels).T)

    def add_marker(self, label: str, sample_id: int, channel: int = -1) -> None:
        """Add a marker."""
        self._markers[label] = SoundMarker(label, channel, sample_id)

    def getMarkers(self) -> list[SoundMarker]:
        """Return all markers, sorted by label."""
        return [self._markers[label] for label in sorted(self._markers)]

    def getMarker(self, index: int) -> SoundMarker:
        """Return the marker at an index of the list that `getMarkers` returns."""
        return self.getMarkers()[index]

    def get_marker(self, marker_label: str) -> tuple[bool, int, int]:
        """Return whether the marker exists, its sample, and its channel or -1."""
        marker = self._markers.get(marker_label)
        return (False, 0, -1) if marker is None else (True, marker.sample_id, marker.channel)

    def remove_marker(self, marker_label: str) -> None:
        """Remove a marker, if it exists."""
        self._markers.pop(marker_label, None)

    def getMarkersCount(self) -> int:
        """Return the number of markers."""
        return len(self._markers)

    def remove_all_markers(self) -> None:
        """Remove all markers."""
        self._markers = {}

    def _writable(self) -> NDArray[Any]:
        """Return the samples in writable memory, copied if needed."""
        if not self._samples.flags.writeable:
            self._samples = self._samples.copy()
        return self._samples

    def _same_format(self, other: Sound) -> bool:
        """Return whether both have the same number of channels and frequency; log an error if not."""
        alike = (self.getChannels(), self._frequency) == (other.getChannels(), other._frequency)
        if not alike:
            log.error("the channels or frequencies of %r and %r differ", self, other)
        return alike

    def _place(self, marker: int | str, default: int) -> int:
        """Return the sample of a marker, ``default`` if it does not exist; a number is returned unchanged."""
        if isinstance(marker, int):
            return marker
        exists, sample, _ = self.get_marker(marker)
        if not exists:
            log.warning("marker %s not found", marker)
        return sample if exists else default

    @override
    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Sound):
            return NotImplemented
        same = (self._frequency, self._markers) == (other._frequency, other._markers)
        return same and np.array_equal(self._samples, other._samples)

    @override
    def __repr__(self) -> str:
        return f"<Sound of {self.getSamples()} samples in {self.getChannels()} channels at {self._frequency} Hz>"

    @override
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

    @override
    def _read(self, source: ElementReader) -> None:
        parts = source.begin()
        if parts not in (4, 5, 6):
            raise WireError(f"invalid sound: expected 4, 5 or 6 parts, not {parts}")
        _, samples, _, channels, _, size, _, frequency = source.raw(_FIELDS)
        if size != 2:
            raise WireError(f"sounds have 2 bytes per sample, not {size}")
        if min(samples, channels) < 0 or samples * channels > _LARGEST:
            raise WireError(f"invalid sound: {samples} samples in {channels} channels")
        if parts > 4:
            code, count = source.raw(_LIST)
            if code != LIST | INT16 or count != samples * channels:
                raise WireError(f"invalid sound: {count} of tag {code} for {samples} samples in {channels} channels")
        values = np.frombuffer(source.block(2 * samples * channels), _SAMPLE)
        markers = _markers(source) if parts == 6 else {}
        source.leave()
        self._samples, self._frequency, self._markers = values.reshape(channels, samples), frequency, markers


def _markers(source: ElementReader) -> dict[str, SoundMarker]:
    code, count = source.raw(_LIST)
    if code != LIST or count < 0:
        raise WireError(f"invalid sound: expected a list of markers, not {code} of {count}")
    markers = {}
    for _ in range(count):
        if source.raw(_LIST) != (LIST, 4):
            raise WireError(f"invalid sound: the marker before byte {source.at} is not a list of 4")
        key, label = _text(source), _text(source)
        markers[key] = SoundMarker(label, *source.raw(_PLACE))
    return markers


def _text(source: ElementReader) -> str:
    size = int(source.raw(_LENGTH)[0])
    if size < 0:
        raise WireError(f"invalid sound: a string of {size} bytes before byte {source.at}")
    return str(source.block(size), "utf-8", "surrogateescape")
