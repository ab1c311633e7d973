"""Data from other machines is read in the byte order of its protocol, not in that of this machine."""

from __future__ import annotations

import ast
import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from bridge.messages.transcode import vm

ROOT = Path(__file__).parents[1]
ORDERS = tuple("<>!=@")
"""struct's marks of a byte order; = and @ are this machine's, for data that does not leave it."""

ONE_BYTE = {"bool_", "int8", "uint8"}


def calls(*names: str) -> Iterator[tuple[str, ast.Call]]:
    """Yield each call of a function or method with one of these names, with its place."""
    for package in ("bridge", "navigation", "sim", "yarp_compat"):
        for file in sorted((ROOT / package).rglob("*.py")):
            text = file.read_text(encoding="utf-8")
            for node in ast.walk(ast.parse(text)) if any(f".{name}(" in text for name in names) else ():
                if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in names:
                    yield f"{file.relative_to(ROOT)}:{node.lineno}", node


def names_order(layout: ast.expr) -> bool:
    """Return whether a format for struct begins with a byte order, or needs none; True for a variable."""
    if isinstance(layout, ast.JoinedStr):
        layout = layout.values[0]
    text = layout.value if isinstance(layout, ast.Constant) else "="
    return isinstance(text, str) and (text.startswith(ORDERS) or not set(text) - set("0123456789bBcsx?"))


def test_each_binary_layout_names_its_byte_order() -> None:
    layouts = [
        (place, call.args[0])
        for place, call in calls("Struct", "calcsize", "iter_unpack", "pack", "pack_into", "unpack", "unpack_from")
        if call.args and "struct" in ast.unparse(call.func)
    ]
    assert len(layouts) > 100
    assert [place for place, layout in layouts if not names_order(layout)] == []


def test_numbers_in_received_bytes_have_a_fixed_byte_order() -> None:
    """For example ``np.frombuffer(data, "<f4")``, but not ``np.frombuffer(data, np.float32)``."""
    types = [(place, call.args[1]) for place, call in calls("frombuffer") if len(call.args) > 1]
    assert len(types) > 20
    native = [place for place, kind in types if isinstance(kind, ast.Attribute) and kind.attr not in ONE_BYTE]
    native += [place for place, kind in types if isinstance(kind, ast.Constant) and str(kind.value)[0] not in "<>"]
    assert native == []


def test_a_big_endian_machine_is_rejected_before_it_converts_a_message(monkeypatch: pytest.MonkeyPatch) -> None:
    """Messages on the hub are little-endian CDR, which the converters read with this machine's instructions."""
    spec = importlib.util.spec_from_file_location("vm", Path(vm.__file__).with_name("vm.py"))
    assert spec is not None
    assert spec.loader is not None
    monkeypatch.setattr(sys, "byteorder", "big")
    with pytest.raises(ImportError, match="need a little-endian machine"):
        spec.loader.exec_module(importlib.util.module_from_spec(spec))
