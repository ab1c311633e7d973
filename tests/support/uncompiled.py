"""Loads a kernel's source as uncompiled Python, in addition to its compiled form."""

from __future__ import annotations

import importlib.util
import sys
from functools import cache
from importlib.machinery import SourceFileLoader
from types import ModuleType

from bridge import kernels


@cache
def uncompiled(name: str) -> ModuleType:
    """Return a kernel's module, run from its ``.py``; the imported module stays compiled.

    Args:
        name: one of `bridge.kernels.KERNELS`.
    """
    other = f"{name}_uncompiled"
    spec = importlib.util.spec_from_loader(other, SourceFileLoader(other, str(kernels.source(name))))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[other] = module  # dataclasses look up their module
    spec.loader.exec_module(module)
    return module
