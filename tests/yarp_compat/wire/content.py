"""Hypothesis strategies for values of every type that a Bottle can contain."""

from __future__ import annotations

import math
from typing import Any

from hypothesis import strategies as st

from yarp_compat.wire.text import rounded
from yarp_compat.wire.values import Float32, Int8, Int16, Int64, Vocab, Vocab64

letters = st.text([chr(code) for code in range(33, 127) if chr(code) not in r'"\()[]{},'], min_size=1, max_size=8)
nonempty = letters.filter(lambda word: word != "1")
"""Excludes the word `1`, which would be true."""
strings = st.text(st.characters(exclude_categories=["Cs"]), max_size=20) | st.binary(max_size=8).map(
    lambda data: data.decode(errors="surrogateescape")
)
numbers = (
    st.integers(-(2**63), 2**63 - 1)
    | st.integers(-(2**31) - 2, 2**31 + 1)
    | st.integers(-(2**7), 2**7 - 1).map(Int8)
    | st.integers(-(2**15), 2**15 - 1).map(Int16)
    | st.integers(-(2**63), 2**63 - 1).map(Int64)
    | st.floats()
    | st.floats(width=32).map(Float32)
)
vocabs = st.booleans() | nonempty.map(Vocab)
leaves = numbers | vocabs | nonempty.map(Vocab64) | strings | st.binary(max_size=20)


def _inner(values: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    entry = values | st.just(()) | st.lists(values, min_size=2, max_size=3).map(tuple)
    return (
        st.lists(values, max_size=6)
        | st.lists(st.floats(), max_size=5)
        | st.lists(st.integers(-100, 100).map(Int8), max_size=5)
        | st.dictionaries(strings, entry, max_size=4)
    )


bottles = st.lists(st.recursive(leaves, _inner, max_leaves=20), max_size=8) | st.lists(numbers, max_size=8)


def typed(value: Any) -> Any:
    """Add the wire types to a value for comparison: ints are compared with their size, and nan equals itself."""
    if isinstance(value, (list, tuple)):
        return [typed(item) for item in value]
    if isinstance(value, dict):
        entries = {key: item if isinstance(item, tuple) else (item,) for key, item in value.items()}
        return {key: typed(entries[key]) for key in sorted(entries)}
    if isinstance(value, float):
        held = rounded(value) if isinstance(value, Float32) else value
        return type(value).__name__, "nan" if math.isnan(held) else held.hex()
    if type(value) is Int64 and not -(2**31) <= value < 2**31:
        return "int", int(value)
    if isinstance(value, Vocab):
        wide = type(value) is Vocab64 or len(value) > 4
        return "Vocab64" if wide else "Vocab", str(value)
    return type(value).__name__, value
