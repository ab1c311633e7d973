"""Midspan's configuration: one YAML file, its model, its loader and what is generated from the model."""

from __future__ import annotations

from bridge.config.load import find, load, loads
from bridge.config.model import Config
from bridge.config.problems import ConfigError, Problem

__all__ = ["Config", "ConfigError", "Problem", "find", "load", "loads"]
