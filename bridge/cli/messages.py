"""Messages for people, written as YAML and read from YAML."""

from __future__ import annotations

from functools import cache
from typing import Any

from bridge.cli.output import CliError

MAX_ITEMS = 16
MAX_TEXT = 200


class _Row(list[Any]):
    """A list that is written on one line."""


def message_text(message: Any, *, full: bool = False) -> str:
    """Format a message as YAML; unless ``full``, arrays are cut to `MAX_ITEMS` and texts to `MAX_TEXT` characters."""
    import yaml  # not needed to list topics

    text: str = yaml.dump(
        _shortened(message, full=full), Dumper=_dumper(), sort_keys=False, default_flow_style=False, allow_unicode=True,
        width=1_000_000 if full else 160,
    )  # fmt: skip
    return text


@cache
def _dumper() -> Any:
    """Return a YAML dumper that writes `_Row` in flow style, and rejects other Python objects."""
    import yaml

    class Dumper(yaml.SafeDumper):
        pass

    tag = "tag:yaml.org,2002:seq"
    Dumper.add_representer(_Row, lambda dumper, row: dumper.represent_sequence(tag, row, flow_style=True))
    return Dumper


def _shortened(value: Any, *, full: bool) -> Any:
    if isinstance(value, dict):
        return {name: _shortened(item, full=full) for name, item in value.items()}
    if isinstance(value, list):
        items = value if full else value[:MAX_ITEMS]
        shaped = [_shortened(item, full=full) for item in items]
        if len(items) < len(value):
            shaped.append(f"... ({len(value)} in all)")
        nested = any(isinstance(item, dict | list) for item in items)
        return shaped if nested else _Row(shaped)
    if isinstance(value, str) and not full and len(value) > MAX_TEXT:
        return f"{value[:MAX_TEXT]}... ({len(value)} characters in all)"
    return value


def yaml_fields(text: str) -> dict[str, Any]:
    """Parse a message's fields from YAML 1.2 or JSON; raises `CliError` if the text is neither, or not a map."""
    import yaml

    from bridge.config.document import Yaml12Loader

    try:
        value = yaml.load(text, Yaml12Loader)  # noqa: S506 - it derives from the safe one
    except (KeyError, RecursionError, TypeError, ValueError, yaml.YAMLError) as err:
        raise CliError(f"the message is neither YAML nor JSON: {err}") from None
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise CliError(f"the message must be a map of fields, for example '{{data: hi}}', not {value!r}")
    return value
