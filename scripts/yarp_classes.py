"""Writes the section "Class by class" of docs/yarp/python.md: what of YARP's bindings yarp_compat has, and what not.

    python scripts/yarp_classes.py      after names were added or taken away

The bindings' names are those of tests/yarp_compat/data/bindings.txt, the reasons those of yarp_compat/absences.py.
"""

from __future__ import annotations

import re
import sys
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from yarp_compat import absences, check  # noqa: E402 - from this tree

PAGE = ROOT / "docs" / "yarp" / "python.md"
BEGIN, END = "<!-- class by class: scripts/yarp_classes.py -->", "<!-- end of class by class -->"
_MANY = 4  # names of one beginning are told by that from so many on


@dataclass
class Bindings:
    """The names of the official bindings: classes with their methods, functions, constants."""

    classes: dict[str, set[str]] = field(default_factory=dict)
    functions: set[str] = field(default_factory=set)
    constants: set[str] = field(default_factory=set)

    @classmethod
    def read(cls, path: Path = ROOT / "tests" / "yarp_compat" / "data" / "bindings.txt") -> Bindings:
        """The names in the file."""
        found = cls()
        into: list[set[str]] = []
        for line in path.read_text(encoding="utf-8").splitlines():
            head = re.fullmatch(r"(class|functions|constants)\s*([\w ]*):", line)
            if head and head[1] == "class":
                into = [found.classes.setdefault(name, set()) for name in head[2].split()]
            elif head:
                into = [found.functions if head[1] == "functions" else found.constants]
            elif line.startswith(" "):
                for names in into:
                    names.update(line.split())
        return found


def absent(names: Iterable[str]) -> dict[str, list[str]]:
    """The names that are not here, by what is said of them."""
    said = defaultdict(list)
    for name in sorted(names):
        if check.lacking(name)[0]:
            said[absences.instead(name)].append(name)
    return said


def methods(bindings: Bindings) -> dict[str, dict[str, list[str]]]:
    """Each class that is here, and its methods that are not, by what is said of them."""
    here = [name for name in sorted(bindings.classes) if not check.lacking(name)[0]]
    return {
        name: {
            said: [one.partition(".")[2] for one in lost]
            for said, lost in absent(f"{name}.{method}" for method in bindings.classes[name]).items()
        }
        for name in here
    }


def section(bindings: Bindings) -> str:
    """The section's text."""
    here = methods(bindings)
    whole = [name for name, lost in here.items() if not lost]
    lines = [
        BEGIN,
        f"The bindings of YARP 3.9.1, 3.12.3 and 4.0.0 together have {len(bindings.classes)} classes.",
        f"{len(here)} of them are here, {len(whole)} with every method: {_code(whole)}.",
        "",
        "| these lack | methods | why, and what instead |",
        "|---|---|---|",
    ]
    alike = defaultdict(list)
    for name, lost in here.items():
        for said, own in lost.items():
            alike[tuple(own), said].append(name)
    lines += [f"| {_code(names)} | {_code(own)} | {said} |" for (own, said), names in sorted(alike.items(), key=_first)]
    lines += ["", "| classes that are not here | why, and what instead |", "|---|---|"]
    lines += _rows(absent(bindings.classes))
    lines += ["", "| functions and constants that are not here | why, and what instead |", "|---|---|"]
    lines += _rows(absent(bindings.functions | bindings.constants), short=True)
    return "\n".join([*lines, END])


def _first(row: tuple[object, list[str]]) -> list[str]:
    return row[1]


def _rows(said: Mapping[str, list[str]], *, short: bool = False) -> list[str]:
    rows = sorted((_shortened(names) if short else names, why) for why, names in said.items())
    return [f"| {_code(names)} | {why} |" for names, why in rows]


def _shortened(names: Iterable[str]) -> list[str]:
    """Names, those of one beginning as one: ``VOCAB_...``."""
    groups = defaultdict(list)
    for name in names:
        groups[name.partition("_")[0] if "_" in name else name].append(name)
    return [one for begin, own in groups.items() for one in ([f"{begin}_..."] if len(own) >= _MANY else own)]


def _code(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def main() -> None:
    """Write the section into the page."""
    text = PAGE.read_text(encoding="utf-8")
    old = text[text.index(BEGIN) : text.index(END) + len(END)]
    PAGE.write_text(text.replace(old, section(Bindings.read())), encoding="utf-8")


if __name__ == "__main__":
    main()
