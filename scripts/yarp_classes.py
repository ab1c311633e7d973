"""Write the section "Class by class" of docs/yarp/python.md: the names of the bindings that yarp_compat has and lacks.

    python scripts/yarp_classes.py      after names were added or removed

The names come from tests/yarp_compat/data/bindings.txt, the reasons from yarp_compat/absences.py.
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
_MANY = 4  # names with the same beginning, if there are at least so many, are shortened to the beginning


@dataclass
class Bindings:
    """The names of the official bindings: classes with their methods, functions, constants."""

    classes: dict[str, set[str]] = field(default_factory=dict)
    functions: set[str] = field(default_factory=set)
    constants: set[str] = field(default_factory=set)

    @classmethod
    def read(cls, path: Path = ROOT / "tests" / "yarp_compat" / "data" / "bindings.txt") -> Bindings:
        """Return the names in the file."""
        bindings = cls()
        into: list[set[str]] = []
        for line in path.read_text(encoding="utf-8").splitlines():
            head = re.fullmatch(r"(class|functions|constants)\s*([\w ]*):", line)
            if head and head[1] == "class":
                into = [bindings.classes.setdefault(name, set()) for name in head[2].split()]
            elif head:
                into = [bindings.functions if head[1] == "functions" else bindings.constants]
            elif line.startswith(" "):
                for names in into:
                    names.update(line.split())
        return bindings


def absent(names: Iterable[str]) -> dict[str, list[str]]:
    """Return the missing names by their reason."""
    by_reason = defaultdict(list)
    for name in sorted(names):
        if check.lacking(name)[0]:
            by_reason[absences.instead(name)].append(name)
    return by_reason


def methods(bindings: Bindings) -> dict[str, dict[str, list[str]]]:
    """Return each implemented class with its missing methods by their reason."""
    implemented = [name for name in sorted(bindings.classes) if not check.lacking(name)[0]]
    return {
        name: {
            reason: [missing_name.partition(".")[2] for missing_name in missing]
            for reason, missing in absent(f"{name}.{method}" for method in bindings.classes[name]).items()
        }
        for name in implemented
    }


def section(bindings: Bindings) -> str:
    """Return the text of the section."""
    classes = methods(bindings)
    complete = [name for name, missing in classes.items() if not missing]
    lines = [
        BEGIN,
        f"The bindings of YARP 3.9.1, 3.12.3 and 4.0.0 together have {len(bindings.classes)} classes.",
        f"yarp_compat has {len(classes)} of them, {len(complete)} with every method: {_code(complete)}.",
        "",
        "| classes | missing methods | reason and replacement |",
        "|---|---|---|",
    ]
    alike = defaultdict(list)
    for name, missing in classes.items():
        for reason, lacking in missing.items():
            alike[tuple(lacking), reason].append(name)
    rows = sorted(alike.items(), key=_first)
    lines += [f"| {_code(names)} | {_code(lacking)} | {reason} |" for (lacking, reason), names in rows]
    lines += ["", "| missing classes | reason and replacement |", "|---|---|"]
    lines += _rows(absent(bindings.classes))
    lines += ["", "| missing functions and constants | reason and replacement |", "|---|---|"]
    lines += _rows(absent(bindings.functions | bindings.constants), short=True)
    return "\n".join([*lines, END])


def _first(row: tuple[object, list[str]]) -> list[str]:
    return row[1]


def _rows(by_reason: Mapping[str, list[str]], *, short: bool = False) -> list[str]:
    rows = sorted((_shortened(names) if short else names, reason) for reason, names in by_reason.items())
    return [f"| {_code(names)} | {reason} |" for names, reason in rows]


def _shortened(names: Iterable[str]) -> list[str]:
    """Combine names with the same beginning: ``VOCAB_...``."""
    groups = defaultdict(list)
    for name in names:
        groups[name.partition("_")[0] if "_" in name else name].append(name)
    return [name for begin, group in groups.items() for name in ([f"{begin}_..."] if len(group) >= _MANY else group)]


def _code(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def main() -> None:
    """Write the section into the page."""
    text = PAGE.read_text(encoding="utf-8")
    old = text[text.index(BEGIN) : text.index(END) + len(END)]
    PAGE.write_text(text.replace(old, section(Bindings.read())), encoding="utf-8")


if __name__ == "__main__":
    main()
