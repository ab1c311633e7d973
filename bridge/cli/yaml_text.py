"""Messages as YAML for people: fields one below the other, numbers in a row, long arrays and texts shortened."""

from __future__ import annotations

import json
from typing import Any

import yaml

MAX_ITEMS = 16
MAX_TEXT = 200


class _Row(list[Any]):
    """A list that is written on one line."""


class _Dumper(yaml.SafeDumper):
    """Writes `_Row` in flow style; knows no Python objects."""


_Dumper.add_representer(
    _Row, lambda dumper, row: dumper.represent_sequence("tag:yaml.org,2002:seq", row, flow_style=True)
)


def message_text(message: Any, *, full: bool = False) -> str:
    """A message as YAML.

    Args:
        message: its fields as JSON values.
        full: whether long arrays and texts are written whole; else `MAX_ITEMS` items or `MAX_TEXT` characters of them.
    """
    text: str = yaml.dump(
        _shaped(message, full=full), Dumper=_Dumper, sort_keys=False, default_flow_style=False, allow_unicode=True,
        width=1_000_000 if full else 160,
    )  # fmt: skip
    return text


def _shaped(value: Any, *, full: bool) -> Any:
    if isinstance(value, dict):
        return {name: _shaped(item, full=full) for name, item in value.items()}
    if isinstance(value, list):
        items = value if full else value[:MAX_ITEMS]
        shaped = [_shaped(item, full=full) for item in items]
        if len(items) < len(value):
            shaped.append(f"... ({len(value)} in all)")
        nested = any(isinstance(item, dict | list) for item in items)
        return shaped if nested else _Row(shaped)
    if isinstance(value, str) and not full and len(value) > MAX_TEXT:
        return f"{value[:MAX_TEXT]}... ({len(value)} characters in all)"
    return value


def json_line(value: Any) -> str:
    """A value as one line of JSON."""
    return json.dumps(value, ensure_ascii=False)
