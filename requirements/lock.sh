#!/bin/sh
# Rewrites the hash-locked requirements from pyproject.toml (`make lock`); needs uv on the path.
# The files name no registry: which one is asked is the installing machine's own setting.
set -eu
cd "$(dirname "$0")/.."
options="--universal --python-version 3.11 --generate-hashes --no-header --no-annotate --no-emit-index-url --no-emit-find-links --quiet --no-config --fork-strategy fewest"
lock() {
  out=$1
  shift
  # shellcheck disable=SC2086
  uv pip compile $options "$@" -o "$out" >/dev/null
  if grep -nE '://|file:|@ ' "$out"; then
    echo "$out names an address" >&2
    exit 1
  fi
}
lock requirements/run.txt pyproject.toml --group build
lock requirements/dev.txt pyproject.toml --group dev -c requirements/run.txt
