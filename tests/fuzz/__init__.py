"""Fuzzers for all of Midspan's parsers; see docs/develop/fuzzing.md."""
