#!/bin/sh
# Makes sure that the system has what pip cannot bring: the venv module, Python's headers, a C++20 compiler
# and, with the argument `test`, GoogleTest. Installs Debian's packages where it may, else names them. Tests of
# reports want a browser, those of recordings ROS 1, and are skipped where these cannot be had.
set -eu

python=${PYTHON:-python3}
cxx=${CXX:-c++}
purpose=${1:-run}

compiles() {
  printf '%s\n' "$1" | "$cxx" -std=c++20 -x c++ -fsyntax-only - 2>/dev/null
}

find_missing() {
  missing=""
  "$python" -c 'import ensurepip, venv' 2>/dev/null || missing="$missing python3-venv"
  "$python" -c 'import os, sys, sysconfig
sys.exit(not os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h")))' || missing="$missing python3-dev"
  compiles '#include <concepts>' || missing="$missing g++"
  if [ "$purpose" = test ]; then
    compiles '#include <gtest/gtest.h>' || missing="$missing libgtest-dev"
  fi
}

if ! "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then
  echo "TrueWrench needs Python 3.11 or newer as $python (make PYTHON=/path/to/python3)" >&2
  exit 1
fi

find_missing
wanted=""
if [ "$purpose" = test ]; then
  command -v chromium >/dev/null || wanted=chromium
  /usr/bin/python3 -c 'import rosbag, geometry_msgs, sensor_msgs' 2>/dev/null ||
    wanted="$wanted python3-rosbag python3-geometry-msgs python3-sensor-msgs"
fi
[ -n "$missing$wanted" ] || exit 0

if [ "$(id -u)" = 0 ]; then
  as_root=""
elif sudo -n true 2>/dev/null; then
  as_root="sudo -n"
else
  as_root=none
fi
if [ "$as_root" = none ] || ! command -v apt-get >/dev/null; then
  [ -n "$missing" ] || exit 0
  echo "Please install first: apt-get install$missing (or the like on this system)" >&2
  exit 1
fi

install() {
  $as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" >/dev/null
}

echo "Installing$missing${wanted:+ $wanted}"
$as_root apt-get update -qq || true
# shellcheck disable=SC2086
[ -z "$missing" ] || install $missing
# shellcheck disable=SC2086
[ -z "$wanted" ] || install $wanted || echo "Without $wanted, the tests that need them will be skipped" >&2

find_missing
if [ -n "$missing" ]; then
  echo "Still missing for $python and $cxx after installing Debian's packages:$missing" >&2
  exit 1
fi
