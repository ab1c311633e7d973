"""Messages in a form for pages."""

from __future__ import annotations

from typing import Any

MOST_ITEMS, MOST_TEXT, MOST_DEPTH = 32, 2000, 16


def cut(value: Any, depth: int = 0) -> Any:
    """Truncate a message's long arrays, long texts and deep fields; ``{"...": 360}`` has an array's full length."""
    if isinstance(value, dict):
        return {key: cut(item, depth + 1) for key, item in value.items()} if depth < MOST_DEPTH else {"...": len(value)}
    if isinstance(value, list):
        items = [cut(item, depth + 1) for item in value[:MOST_ITEMS]]
        return [*items, {"...": len(value)}] if len(value) > MOST_ITEMS else items
    if isinstance(value, str) and len(value) > MOST_TEXT:
        return f"{value[:MOST_TEXT]}... ({len(value)} characters in all)"
    return value
