"""Output of commands: errors, and JSON."""

from __future__ import annotations

import json
from typing import Any

from bridge.client.errors import ClientError


class CliError(ClientError):
    """A command failed for a reason that the user can fix; only its text is shown."""


def print_json(value: Any, *, lines: bool = False) -> None:
    """Write a value as JSON: indented, or on one line."""
    print(json_line(value) if lines else json.dumps(value, indent=2, ensure_ascii=False), flush=True)


def json_line(value: Any) -> str:
    """Format a value as one line of JSON."""
    return json.dumps(value, ensure_ascii=False)


def system_error(err: OSError) -> str:
    """Return an error of the system without its number: ``maps/a.map: permission denied``."""
    if not err.strerror:
        return str(err)
    reason = f"{err.strerror[:1].lower()}{err.strerror[1:]}"
    return f"{err.filename}: {reason}" if err.filename else reason
