#!/bin/sh
# Sets up this checkout: system packages, virtual environment, locked dependencies, ROS 2 message packages.
# Finished steps are skipped, so a second run takes a second. The output of apt, pip and the compilers goes to
# .cache/setup.log; the terminal shows each step, its duration and its progress. Variables:
#   PYTHON         the Python for the virtual environment (3.11 or newer)
#   CI=true        anything unavailable is an error; also installs Prometheus and nginx for tests
#   BROWSER=yes    also installs Chromium for the tests of the console
#   KILTED=yes     also installs ROS 2 Kilted, for tests with programs of another release
#   MIDSPAN_CACHE  folder of built message packages; default ~/.cache/midspan/interfaces
# If /opt/ros/jazzy, kilted or lyrical is sourced, its packages are used and no ROS 2 wheels are installed.
set -eu
cd "$(dirname "$0")/.."

tools="g++ git libgl1 make python3-dev python3-venv" # libgl1: DART's wheel is linked with OpenGL
ros1="python3-actionlib python3-actionlib-msgs python3-diagnostic-msgs python3-geometry-msgs python3-map-msgs
    python3-move-base-msgs python3-nav-msgs python3-rosgraph-msgs python3-roslaunch python3-rosnode python3-rosparam
    python3-rospy python3-rosservice python3-rostopic python3-sensor-msgs python3-shape-msgs python3-std-msgs
    python3-std-srvs python3-stereo-msgs python3-tf2 python3-tf2-msgs python3-tf2-ros python3-trajectory-msgs
    python3-visualization-msgs"
if [ "${CI:-}" = true ]; then
    tools="$tools systemd procps octomap-tools" # procps: the units reload with /bin/kill
    tools="$tools debootstrap lintian" # the Debian package is installed in a fresh system
    BROWSER=yes
    KILTED=yes
fi
if [ -n "${BROWSER:-}" ]; then
    tools="$tools chromium chromium-driver"
fi

log=.cache/setup.log
began=$(date +%s)
worked=""

say() {
    printf 'setup: %s\n' "$*" >&2
}

fail() {
    say "$*"
    exit 1
}

# Writes a command's output to the log; shows how many of the expected lines, which begin with a word, have appeared.
show_progress() {
    count=0 total=$2
    while IFS= read -r line || [ -n "$line" ]; do
        printf '%s\n' "$line" >>"$log"
        case "$line" in
            *" newly installed"*) # apt: each package is downloaded, and set up
                total=${line#*, }
                total=$((${total%% *} * 2))
                ;;
            $1)
                count=$((count + 1))
                if [ -t 2 ]; then
                    printf '\rsetup:   %d of %d ' "$count" "$total" >&2
                elif [ $((count % 25)) -eq 0 ]; then
                    say "  $count of $total"
                fi
                ;;
        esac
    done
    if [ -t 2 ] && [ "$count" -gt 0 ]; then
        printf '\n' >&2
    fi
}

# Runs a command with its output in the log; if it fails, shows the end of the log.
# logged WORD TOTAL COMMAND...: lines that begin with the word show its progress
logged() {
    word=$1 total=$2
    shift 2
    mkdir -p .cache
    if [ -z "$worked" ]; then
        : >"$log" # keep only the output of this run
    fi
    worked=yes
    rm -f .cache/setup-failed
    { "$@" 2>&1 || touch .cache/setup-failed; } | show_progress "$word*" "$total"
    if [ -e .cache/setup-failed ]; then
        rm -f .cache/setup-failed
        say "failed: $*"
        tail -n 12 "$log" | sed 's/^/setup: | /' >&2
        say "the whole output is in $PWD/$log"
        return 1
    fi
}

# Reports that something optional is missing: an error in CI, otherwise only a message.
lacking() {
    if [ "${CI:-}" = true ]; then
        fail "$*"
    fi
    say "$*"
}

as_root() {
    if [ "$(id -u)" -eq 0 ]; then
        env "$@"
    elif [ -t 0 ]; then
        sudo env "$@"
    else
        sudo -n env "$@"
    fi
}

# Prints which of the given Debian packages are not installed.
not_installed() {
    installed=" $(dpkg-query -W -f '${db:Status-Status}:${Package}\n' "$@" 2>/dev/null | sed -n 's/^installed://p' | tr '\n' ' ')"
    for package in "$@"; do
        case "$installed" in
            *" $package "*) ;;
            *) printf '%s ' "$package" ;;
        esac
    done
}

# Prints the given Debian packages without those of ROS 1.
without_ros1() {
    # shellcheck disable=SC2086  # a list of words
    ros1_words=" $(echo $ros1) "
    for package in "$@"; do
        case "$ros1_words" in
            *" $package "*) ;;
            *) printf '%s ' "$package" ;;
        esac
    done
}

system_packages() {
    if ! command -v apt-get >/dev/null || ! command -v dpkg-query >/dev/null; then
        lacking "no apt on this system: install a C++ compiler, git and make yourself; rospy is not needed"
        return
    fi
    # shellcheck disable=SC2086  # lists of words
    missing=$(not_installed $tools $ros1)
    if [ -z "$missing" ]; then
        return
    fi
    if [ "$missing" = "$(cat .cache/unavailable 2>/dev/null)" ]; then
        # shellcheck disable=SC2086  # a list of words
        others=$(without_ros1 $missing)
        if [ -n "$others" ] || [ "${CI:-}" = true ]; then
            lacking "still unavailable from apt: ${others:-$missing}(remove .cache/unavailable to try again)"
        fi
        return
    fi
    if [ "$(id -u)" -ne 0 ] && ! command -v sudo >/dev/null; then
        lacking "neither root nor sudo: ask an administrator for: apt-get install $missing"
        return
    fi
    # shellcheck disable=SC2086  # a list of words
    say "installing $(set -- $missing && echo $#) Debian packages and their dependencies (about a minute): $missing"
    logged "no progress" 0 as_root DEBIAN_FRONTEND=noninteractive apt-get -q update || lacking "apt-get update failed"
    known=""
    unknown=""
    for package in $missing; do
        # apt-cache succeeds without output for a name that only other packages mention
        if [ -n "$(apt-cache show "$package" 2>/dev/null)" ]; then
            known="$known $package"
        else
            unknown="$unknown $package"
        fi
    done
    case "$unknown " in
        *" python3-rospy "*) # the rest of ROS 1 is useless without it
            lacking "no python3-rospy in this system's archive, and none is needed: Midspan has its own ROS 1 node and master"
            # shellcheck disable=SC2086
            known=$(without_ros1 $known) unavailable=$unknown unknown=$(without_ros1 $unknown)
            ;;
        *) unavailable=$unknown ;;
    esac
    if [ -n "$unknown" ]; then
        lacking "not in this system's archive: ${unknown# }"
    fi
    # shellcheck disable=SC2086
    if [ -n "$known" ] && ! logged "[GS]et[:t]" 0 as_root DEBIAN_FRONTEND=noninteractive \
        apt-get -q install -y --no-install-recommends $known; then
        lacking "apt-get could not install:$known"
        return
    fi
    if [ -n "$unavailable" ]; then
        mkdir -p .cache
        # shellcheck disable=SC2086
        not_installed $tools $ros1 >.cache/unavailable
    fi
}

find_python() {
    for python in ${PYTHON:+"$PYTHON"} /usr/bin/python3 python3 python3.14 python3.13 python3.12 python3.11; do
        if "$python" -c 'import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; then
            command -v "$python"
            return
        fi
    done
    fail "no Python 3.11 or newer with venv (on Debian: apt install python3-venv); name one in PYTHON"
}

# wheels, or the sourced installation
ros2_source() {
    case "${ROS_DISTRO:-}" in
        jazzy | kilted | lyrical) [ -z "${AMENT_PREFIX_PATH:-}" ] || printf 'sourced %s' "$AMENT_PREFIX_PATH" ;;
    esac
}

# pip_install TOTAL WHAT...
pip_install() {
    total=$1
    shift
    logged Collecting "$total" .venv/bin/python -m pip install --disable-pip-version-check --no-input --progress-bar off \
        --no-deps --use-pep517 "$@"
}

packages_in() {
    grep -c == "$1"
}

# For tests in CI: unpacks the programs of a package into .cache, because the installed package would run a service.
# unpacked PACKAGE PROGRAM MEGABYTES
unpacked() {
    folder=.cache/$1
    if [ "${CI:-}" != true ] || command -v "${2##*/}" >/dev/null || [ -x "$folder/usr/$2" ]; then
        return
    fi
    say "unpacking $1 ($3 MB)"
    mkdir -p "$folder/deb"
    if ! (cd "$folder/deb" && apt-get -q download "$1") >/dev/null 2>&1; then
        logged "no progress" 0 as_root apt-get -q update || true
        (cd "$folder/deb" && apt-get -q download "$1") >/dev/null 2>&1 || lacking "apt-get could not download $1"
    fi
    for file in "$folder/deb/$1"_*.deb; do
        dpkg-deb -x "$file" "$folder" || lacking "cannot unpack $file"
    done
    rm -rf "$folder/deb" "$folder/usr/share" "$folder/etc"
}

# Compiles the kernels from the sources in this folder; without a compiler they run as Python, which is too slow to drive.
kernels() {
    if .venv/bin/python -P bridge/kernels.py >/dev/null; then
        return
    fi
    say "compiling the kernels, two at a time (half a minute)"
    logged compiling "$(.venv/bin/python -P bridge/kernels.py count)" .venv/bin/python setup.py -q build_ext --inplace || true
    if ! left=$(.venv/bin/python -P bridge/kernels.py); then
        lacking "$left
setup: MESSAGES ARE CONVERTED SLOWLY AND NOTHING DRIVES until they are compiled:
setup: install a C compiler and Python's headers (Debian: apt install g++ python3-dev), then run 'make setup' again"
    fi
}

# Installs the wheels of ROS 2 Kilted for tests, during the other steps: into a prefix like /opt/ros/kilted, which
# .cache/kilted links to. Checkouts share it; `await_kilted` waits for it.
kilted() {
    if [ -z "${KILTED:-}" ] || [ -n "$kilted_job" ]; then
        return
    fi
    key=$( { cat requirements-kilted.lock && .venv/bin/python -V; } | sha256sum | cut -c 1-16)
    prefix=${XDG_CACHE_HOME:-$HOME/.cache}/midspan/kilted-$key
    mkdir -p .cache
    if ! [ -d "$prefix" ]; then
        say "installing ROS 2 Kilted for tests, during the other steps: $(packages_in requirements-kilted.lock) packages"
        install_kilted "$prefix" >.cache/kilted.log 2>&1 &
        kilted_job=$!
    fi
    rm -f .cache/kilted
    ln -s "$prefix" .cache/kilted
}

install_kilted() {
    .venv/bin/python -m pip install --disable-pip-version-check --no-input --progress-bar off --no-deps --no-compile \
        --ignore-installed --no-warn-conflicts --no-warn-script-location --prefix "$1.$$" -r requirements-kilted.lock || return
    mv "$1.$$" "$1" || rm -rf "$1.$$" # another checkout was faster
}

await_kilted() {
    if [ -n "$kilted_job" ] && ! wait "$kilted_job" && ! [ -d .cache/kilted/lib ]; then
        tail -n 5 .cache/kilted.log | sed 's/^/setup: | /' >&2
        lacking "ROS 2 Kilted's wheels cannot be installed here: tests with its programs are skipped"
    fi
}

# Creates the virtual environment with all locked packages; a file in it records what it was created from.
environment() {
    source=$(ros2_source)
    source=${source:-wheels}
    made_for="$PWD $source"
    made_from="$made_for $(cat pyproject.toml setup.py requirements.lock requirements-ros2.lock | sha256sum)"
    if [ -x .venv/bin/midspan ] && [ "$made_from" = "$(cat .venv/midspan-setup 2>/dev/null)" ]; then
        return
    fi
    rm -f .venv/midspan-setup
    if ! [ "$made_for" = "$(cat .venv/midspan-place 2>/dev/null)" ] || ! .venv/bin/python -c '' 2>/dev/null; then
        python=$(find_python)
        say "creating .venv with $python ($("$python" -V))"
        "$python" -m venv --clear .venv
        printf '%s\n' "$made_for" >.venv/midspan-place
    fi
    # the pip of Debian 12 takes twice as much processor time for the rest
    pip_install 1 "$(grep '^pip==' requirements.lock)" || fail "pip could not install its locked version"
    kilted
    say "installing $(packages_in requirements.lock) Python packages (half a minute)"
    pip_install "$(packages_in requirements.lock)" -r requirements.lock || fail "pip could not install requirements.lock"
    if [ "$source" != wheels ]; then
        say "using the sourced ROS 2 ($AMENT_PREFIX_PATH)"
    elif say "installing ROS 2 Jazzy: $(packages_in requirements-ros2.lock) packages (a minute)" &&
        ! pip_install "$(packages_in requirements-ros2.lock)" -r requirements-ros2.lock; then
        lacking "the ROS 2 wheels cannot be installed here (see above): ROS 2 (DDS) is left out; or source /opt/ros/jazzy"
        made_from=""
    fi
    kernels # before pip, which would show no progress
    # compat: one line in a .pth file, which also finds packages that are added later
    say "installing Midspan itself, from this folder"
    pip_install 1 --no-build-isolation --config-settings editable_mode=compat --editable . || fail "pip could not install Midspan"
    printf '%s\n' "$made_from" >.venv/midspan-setup
}

# Compiles Midspan's bytecode, because pip compiles only installed packages. Otherwise each of seven processes would
# compile its imports (0.2 s of 0.65 s) at its first start or, with PYTHONDONTWRITEBYTECODE, at each start.
bytecode() {
    .venv/bin/python -m compileall -q -j 2 bridge navigation sim yarp_compat >/dev/null 2>&1 || true # the folder may be read-only
}

kilted_job=""
system_packages
unpacked prometheus bin/promtool 20
unpacked nginx sbin/nginx 1
environment
kernels
bytecode
kilted # if the environment was complete
if .venv/bin/python -c 'import rclpy' 2>/dev/null; then
    # it reports its own progress
    .venv/bin/midspan interfaces build >/dev/null
fi
await_kilted
if [ -n "$worked" ]; then
    say "ready after $(($(date +%s) - began)) s"
fi
