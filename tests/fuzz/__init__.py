"""Fuzzers for every parser of ours; see the document docs/develop/fuzzing.md."""
