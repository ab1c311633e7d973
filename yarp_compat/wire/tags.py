"""The tags of a Bottle's elements, for each profile.

An element's tag is its type; the lower byte of a list's tag is the type of all its elements, if they share one
(`yarp/os/Bottle.h`, `yarp/os/impl/Storable.h`). Sizes do not include the tag.
"""

from __future__ import annotations

from yarp_compat.wire.profile import Profile

INT8 = 32
INT16 = 64
INT32 = 1
INT64 = 17
VOCAB32 = 9
VOCAB64 = 18
STRING = 4
BLOB = 12
LIST = 256
DICT = 512

UNIT = 255  # mask for the tag of the elements in a list's tag
MAX_DEPTH = 128  # maximum levels of nested lists; a dict counts twice. Real messages have fewer than ten

_SIZES = {INT8: 1, INT16: 2, INT32: 4, INT64: 8, VOCAB32: 4}
_FORMATS = {INT8: "b", INT16: "h", INT32: "i", INT64: "q"}


def sizes(profile: Profile) -> dict[int, int]:
    """Return the size in bytes of each type of fixed size."""
    types = {**_SIZES, profile.float32_tag: 4, profile.float64_tag: 8}
    if profile.vocab64_tag is not None:
        types[profile.vocab64_tag] = 8
    return types


def formats(profile: Profile) -> dict[int, str]:
    """Return the format character (of `struct` and numpy) of each type of number."""
    return {**_FORMATS, profile.float32_tag: "f", profile.float64_tag: "d"}
