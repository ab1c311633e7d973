#!/bin/sh
# The tests: most of them three at a time, then those that hold a promise in seconds or memory by themselves.
# A test of the first kind that fails beside others runs once more by itself, since three at a time two cores may keep
# a middleware waiting longer than any deadline. It is named then; one that fails by itself too fails the run, and so
# does a process or thread that tests which passed leave behind.
# Usage: scripts/test.sh [PYTEST ARGUMENT ...]

set -u
cd "$(dirname "$0")/.."
pytest=".venv/bin/python -m pytest"
cache=.cache/pytest
none=5 # pytest's exit code where no test was chosen

say() {
    printf 'tests: %s\n' "$*" >&2
}

rm -rf "$cache"
$pytest -o cache_dir="$cache" -n 3 --dist loadfile --no-loadscope-reorder -m 'not alone' "$@"
code=$?
if [ $code -eq 1 ] && [ -s "$cache/v/cache/lastfailed" ]; then
    say "these failed beside others, and run once more by themselves:"
    sed -n 's/^  "\(.*\)": true,*$/tests:   \1/p' "$cache/v/cache/lastfailed" >&2
    $pytest -o cache_dir="$cache" --last-failed --last-failed-no-failures none -p no:randomly -m 'not alone' "$@"
    code=$?
    [ $code -eq 0 ] && say "all of them passed by themselves: on a busy machine they are not reliable yet"
fi
[ $code -eq 0 ] || [ $code -eq $none ] || exit $code
$pytest -p no:cacheprovider -m alone "$@"
code=$?
[ $code -eq 0 ] || [ $code -eq $none ] || exit $code
