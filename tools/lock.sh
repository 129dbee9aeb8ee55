#!/usr/bin/env bash
# Writes requirements/*.lock from requirements/*.in: what a fresh environment gets today.
set -euo pipefail
cd "$(dirname "$0")/.."
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
for what in run test; do
  "${PYTHON:-python3}" -m venv "$work/$what"
  # torch is named first: another package's open range must not pick another build of it
  "$work/$what/bin/python" -m pip install -q --disable-pip-version-check -r "requirements/$what.in"
  {
    echo "# made by tools/lock.sh from requirements/$what.in"
    "$work/$what/bin/python" -m pip freeze --all --disable-pip-version-check | grep -v '^pip==' | sed 's/+cpu$//' |
      sed "s/^labmaze==.*/&; python_version < '3.13'/" # no wheel for 3.13, and nothing uses it
  } > "requirements/$what.lock"
done
