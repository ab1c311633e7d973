"""Messages as JSON texts, for programs that have no ROS; see `bridge.messages.json` for the rules."""

from __future__ import annotations

import json
from collections.abc import Callable

from bridge.messages.errors import ConversionError
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry


def text_to_cdr(registry: Registry, type_name: str) -> Callable[[bytes], bytes]:
    """The converter of JSON texts to CDR."""

    def convert(text: bytes) -> bytes:
        try:
            value = json.loads(text)
        except (ValueError, RecursionError) as err:
            msg = f"no JSON: {err}"
            raise ConversionError(msg) from None
        if not isinstance(value, dict):
            msg = f"a {type_name} is a JSON object with its fields, not {type(value).__name__}"
            raise ConversionError(msg)
        return from_json(registry, type_name, value)

    return convert


def cdr_to_text(registry: Registry, type_name: str) -> Callable[[bytes], bytes]:
    """The converter of CDR to JSON texts in UTF-8."""

    def convert(cdr: bytes) -> bytes:
        value = to_json(registry, type_name, cdr)
        return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()

    return convert
