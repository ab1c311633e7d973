"""Loads the valid parts of a file with problems, for commands that must reach a daemon which runs regardless.

A running daemon keeps its last valid configuration, so `midspan halt` must not depend on what was written since.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from bridge.config.document import MAX_BYTES, ConfigError, Document, parse
from bridge.config.load import from_document
from bridge.config.model import Config

_SECTIONS = re.compile(r"^(?=[^\s#])", re.MULTILINE)
"""The begin of each section: a line that is neither indented nor a comment."""


def load_partly(file: Path) -> Config:
    """Return the configuration of the sections that are valid, and of the valid keys of the others.

    The file may be invalid YAML, for example if it is written at this moment; sections that cannot be parsed are left
    out. A file that cannot be read yields the defaults.
    """
    try:
        with file.open("rb") as stream:
            text = stream.read(MAX_BYTES).decode(errors="replace")
    except OSError:
        return Config()
    config = Config()
    for section in _SECTIONS.split(text):
        try:
            data = parse(file, section).data
        except ConfigError:
            continue
        for name, value in data.items() if isinstance(data, dict) else ():
            config = _with_section(config, file, name, value)
    return config


def _with_section(config: Config, file: Path, name: str, value: Any) -> Config:
    """Return the configuration with a section, if necessary only with its keys that are valid by themselves."""
    whole = _valid(file, {name: value})
    if whole is None and isinstance(value, dict):
        kept = {key: inner for key, inner in value.items() if _valid(file, {name: {key: inner}}) is not None}
        whole = _valid(file, {name: kept})
    if whole is None:
        return config
    return config.model_copy(update={field: getattr(whole, field) for field in whole.model_fields_set})


def _valid(file: Path, data: dict[str, Any]) -> Config | None:
    try:
        return from_document(Document(file, data), client=True)
    except ConfigError:
        return None
