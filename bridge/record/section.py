"""The section ``record``: which topics are recorded, into which files, and when a ring is saved."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from bridge.config.sections.section import Section, SideName, TopicName, setting, subsection


def _compiles(value: str) -> str:
    try:
        re.compile(value)
    except re.error as err:
        raise ValueError(f"{value!r} is not a regular expression: {err}") from None
    return value


TopicGlob = Annotated[str, Field(min_length=1, max_length=1024, pattern=r"^/\S*$")]
Expression = Annotated[str, Field(min_length=1, max_length=1024), AfterValidator(_compiles)]


class SplitSection(Section):
    """When a recording continues in another file."""

    size: int = setting(1024, "Maximum size of a file, megabytes (1,048,576 bytes); 0: no limit.", ge=0, le=1 << 20)
    seconds: float = setting(0.0, "Maximum duration of a file, seconds; 0: no limit.", ge=0.0, le=7 * 86400.0)


class RingSection(Section):
    """Keep only the last minutes, and write them to a file on a trigger."""

    seconds: float = setting(0.0, "Duration of the ring, seconds; 0: no ring, everything is kept.", ge=0.0, le=86400.0)
    size: int = setting(2048, "Maximum size of the ring, megabytes.", ge=16, le=1 << 20)


class KeepSection(Section):
    """Limits of the folder; the oldest recordings are deleted to make room for new ones."""

    size: int = setting(
        10_240, "Maximum size of all recordings in the folder, megabytes; 0: no limit.", ge=0, le=1 << 30
    )
    files: int = setting(
        0, "Maximum number of recordings (files, or folders of saved rings); 0: no limit.", ge=0, le=100_000
    )


class TriggerSection(Section):
    """Triggers that write the ring to a file, in addition to `midspan record --daemon trigger`."""

    topics: tuple[TopicName, ...] = setting((), "A message on one of these topics.", max_length=64)
    halt: bool = setting(True, "`midspan halt`, and a halt in the console.")
    goals: bool = setting(True, "A goal of the gateway that failed.")


class RecordSection(Section):
    """Recording in the daemon."""

    enabled: bool = setting(False, "Whether the daemon records.")
    topics: tuple[TopicGlob, ...] = setting(
        ("/**",), "Topics, by name or glob as in rules; topics that the rules do not bridge must be named in full."
    )
    exclude: tuple[Expression, ...] = setting(
        (), "Regular expressions; topics whose names contain a match are left out."
    )
    sides: tuple[SideName, ...] = setting(
        (), "Record only topics of these sides, including topics that are not bridged; default: all topics on the hub."
    )
    folder: Path | None = setting(None, "Where files are written; default `recordings` in the state folder.")
    compression: Literal["zstd", "lz4", "none"] = setting("zstd", "Compression of the file's chunks.")
    queue: int = setting(128, "Maximum size of the messages that wait to be written, megabytes.", ge=1, le=4096)
    split: SplitSection = subsection(SplitSection, "When the recording continues in another file.")
    ring: RingSection = subsection(RingSection, "Keep only the last minutes.")
    keep: KeepSection = subsection(KeepSection, "Limits of the folder.")
    trigger: TriggerSection = subsection(TriggerSection, "Triggers that write the ring.")
