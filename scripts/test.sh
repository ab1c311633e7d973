#!/bin/sh
# The tests: most of them three at a time, then those that hold a promise in seconds or memory by themselves.
# A test that fails runs once more by itself, since beside others, or behind them, two cores may keep a middleware
# waiting longer than any deadline. It is named then; one that fails again fails the run, and so does a process or
# thread that tests which passed leave behind.
# Usage: scripts/test.sh [PYTEST ARGUMENT ...]

set -u
cd "$(dirname "$0")/.."
pytest=".venv/bin/python -m pytest"
cache=.cache/pytest
none=5 # pytest's exit code where no test was chosen

say() {
    printf 'tests: %s\n' "$*" >&2
}

# run MARKS OPTION ... -- PYTEST ARGUMENT ...: the tests with these marks, and those that failed once more
run() {
    marks=$1
    options=
    shift
    while [ "$1" != -- ]; do
        options="$options $1"
        shift
    done
    shift
    rm -rf "$cache"
    # shellcheck disable=SC2086 # options are words
    $pytest -o cache_dir="$cache" $options -m "$marks" "$@"
    code=$?
    if [ $code -eq 1 ] && [ -s "$cache/v/cache/lastfailed" ]; then
        say "these failed, and run once more by themselves:"
        sed -n 's/^  "\(.*\)": true,*$/tests:   \1/p' "$cache/v/cache/lastfailed" >&2
        $pytest -o cache_dir="$cache" --last-failed --last-failed-no-failures none -p no:randomly -m "$marks" "$@"
        code=$?
        [ $code -eq 0 ] && say "all of them passed by themselves: on a busy machine they are not reliable yet"
    fi
    [ $code -eq 0 ] || [ $code -eq $none ] || exit $code
}

run 'not alone' -n 3 --dist loadfile --no-loadscope-reorder -- "$@"
run alone -- "$@"
