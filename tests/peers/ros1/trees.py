"""Random frame trees and lookups in them, the same in two processes; also runs on the system's Python.

A case is a list of steps: ("set", parent, child, stamp in ns, translation, rotation, static), ("clear",),
("ask", target, source, stamp), ("full", target, target stamp, source, source stamp, fixed) and, last, ("frames",).
"""

import math
import random

SECOND = 10**9
START = 1_000_000 * SECOND
"""An early time in ns: tf2_py converts each time to seconds as a double, which rounds present dates by up to 120 ns."""


def rotation(dice, length=1.0):
    """Return a random rotation."""
    parts = [dice.gauss(0, 1) for _ in range(4)]
    x, y, z, w = parts
    norm = math.sqrt(x * x + y * y + z * z + w * w)  # not sum(), which rounds differently from Python 3.12 on
    return tuple(length * p / norm for p in parts)


def pose(dice):
    """Return a random pose; a few are invalid."""
    moved = tuple(dice.uniform(-10, 10) for _ in range(3))
    odd = dice.random()
    if odd < 0.01:
        return (float("nan"), 0.0, 0.0), rotation(dice)
    if odd < 0.02:
        return moved, (0.0, float("nan"), 0.0, 1.0)
    if odd < 0.04:
        return moved, rotation(dice, dice.choice((0.0, 0.99, 0.9949, 0.9951, 1.0049, 1.0051, 1.1)))
    return moved, rotation(dice, dice.uniform(0.997, 1.003) if odd < 0.3 else 1.0)


def transforms(dice, names):
    """Return the transforms of a random forest."""
    steps = []
    spacing = dice.choice((0.01, 0.1, 1.0, 5.0))
    for k in range(1, len(names)):
        if dice.random() < 0.08:
            continue  # a separate root
        parent = names[dice.randrange(k)]
        static = dice.random() < 0.2
        at = START + round(dice.uniform(0, 3 * spacing) * SECOND)
        for _ in range(1 if static else dice.randint(1, 5)):
            at += round(spacing * dice.choice((0.3, 1, 1, 1, 2)) * SECOND)
            odd = dice.random()
            above = dice.choice(names) if odd < 0.04 else parent  # another parent, the frame itself, or a loop
            name = names[k]
            if odd > 0.99:
                above, name = dice.choice((("", name), (above, ""), ("/" + above, "/" + name)))
            stamp = dice.choice((0, at)) if static else at
            steps.append(("set", above, name, stamp, *pose(dice), static))
            if odd > 0.95:
                steps.append(("set", above, name, stamp, *pose(dice), dice.random() < 0.5))  # set twice, or as static
    if dice.random() < 0.3:
        dice.shuffle(steps)
    return steps


def lookup(dice, names, stamps):
    """Return a lookup at the latest time (0), at a transform's stamp, or at a time within a second of it."""

    def stamp() -> int:
        odd = dice.random()
        if odd < 0.25:
            return 0
        near = dice.choice(stamps)
        return near if odd < 0.4 else near + dice.randint(-SECOND, SECOND) // dice.choice((1, 10, 1000))

    def name() -> str:
        odd = dice.random()
        return dice.choice(names) if odd > 0.03 else dice.choice(("nowhere", ""))

    if dice.random() < 0.3:
        return ("full", name(), stamp(), name(), stamp(), name())
    return ("ask", name(), name(), stamp())


def case(dice):
    """Return one tree, and lookups in it."""
    names = [f"f{k}" for k in range(dice.choice((2, 3, 4, 6, 9)))]
    steps = transforms(dice, names)
    if dice.random() < 0.03:
        steps += [("clear",), *transforms(dice, names[:3])]
    stamps = [step[3] for step in steps if step[0] == "set" and step[3]] or [START]
    return steps + [lookup(dice, names, stamps) for _ in range(5)] + [("frames",)]


def cases(seed, count):
    """Return ``count`` cases."""
    dice = random.Random(seed)
    for _ in range(count):
        yield case(dice)
