"""Computes figures from samples: the floor as a sum of hops, and medians over rounds."""

from __future__ import annotations

import random
from collections.abc import Sequence
from statistics import median
from typing import NamedTuple

_SUMS = 20_000


class Figures(NamedTuple):
    """Percentiles of a set of samples, in microseconds."""

    p50: float
    p99: float


def figures(samples: Sequence[int]) -> Figures:
    """Return median and 99th percentile of latencies in nanoseconds."""
    ordered = sorted(samples)
    return Figures(_quantile(ordered, 0.5), _quantile(ordered, 0.99))


def floor(hops: Sequence[Sequence[int]], seed: int) -> Figures:
    """Return the figures of the sums of randomly paired samples, one of each hop.

    A sum of the hops' 99th percentiles would be far too high, because the hops are rarely all slow at once.
    """
    chance = random.Random(seed)
    columns = [chance.choices(hop, k=_SUMS) for hop in hops]
    return figures([sum(triple) for triple in zip(*columns, strict=True)])


def over_rounds(rounds: Sequence[Figures]) -> Figures:
    """Return the median of each figure over the rounds."""
    return Figures(median(r.p50 for r in rounds), median(r.p99 for r in rounds))


def _quantile(ordered: Sequence[int], share: float) -> float:
    return ordered[min(int(len(ordered) * share), len(ordered) - 1)] / 1000
