#!/usr/bin/env bash
# Makes the virtual environment and installs the locked dependencies and the system's OpenGL.
#
#   tools/setup.sh run     what `make demo` needs
#   tools/setup.sh test    what `make test` needs as well
#
# Environment: VENV (default .venv), PYTHON (default: the newest of python3.11 to 3.13).
set -euo pipefail
cd "$(dirname "$0")/.."
what=${1:-run}
venv=${VENV:-.venv}
lock=requirements/$what.lock
stamp=$venv/.installed-$what

say() { printf '%s\n' "$*" >&2; }
fail() { say "error: $*"; exit 1; }

root() { # runs a command as root if this user may without being asked; fails otherwise
  if [ "$(id -u)" = 0 ]; then "$@"
  elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then sudo -n "$@"
  else return 1; fi
}

apt_updated=
apt() {
  command -v apt-get >/dev/null || return 1
  if [ -z "$apt_updated" ]; then
    root env DEBIAN_FRONTEND=noninteractive apt-get update -qq >/dev/null || return 1
    apt_updated=1
  fi
  root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" >/dev/null
}

python_ok() { "$1" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' 2>/dev/null; }

find_python() {
  for candidate in ${PYTHON:-python3.13 python3.12 python3.11 python3}; do
    if command -v "$candidate" >/dev/null && python_ok "$candidate"; then echo "$candidate"; return; fi
  done
  fail "need Python 3.11, 3.12 or 3.13; install one (Debian, Ubuntu: apt-get install python3 python3-venv) or set PYTHON"
}

make_venv() {
  [ -x "$venv/bin/python" ] && python_ok "$venv/bin/python" && return
  local python
  python=$(find_python)
  rm -rf "$venv"
  if ! "$python" -m venv "$venv" 2>/dev/null; then
    rm -rf "$venv"
    apt python3-venv || fail "this Python cannot make virtual environments; run: apt-get install python3-venv"
    "$python" -m venv "$venv"
  fi
}

has_gl() {
  "$venv/bin/python" - <<'EOF'
import ctypes, sys
for name in ("libEGL.so.1", "libOSMesa.so.8"):
    try:
        ctypes.CDLL(name)
        sys.exit(0)
    except OSError:
        pass
sys.exit(1)
EOF
}

install_gl() {
  has_gl && return
  say "installing OpenGL for rendering without a display ..."
  if apt libegl1 libgl1-mesa-dri; then
    apt libosmesa6 || true # newer distributions no longer have it
  else
    say "to get videos, run: sudo apt-get install libegl1 libgl1-mesa-dri libosmesa6"
  fi
}

install_browser() { # for the viewer's test; without it, that test is skipped
  command -v chromium >/dev/null || command -v google-chrome >/dev/null && return
  grep -q '^ID=debian' /etc/os-release 2>/dev/null || return 0
  say "installing Chromium for the viewer's test ..."
  apt chromium || say "the viewer's test will be skipped; to run it: sudo apt-get install chromium"
}

fingerprint() { cat "$lock" pyproject.toml | cksum; }

make_venv
install_gl
[ "$what" = test ] && install_browser
if [ "$(cat "$stamp" 2>/dev/null)" != "$(fingerprint)" ]; then
  say "installing Python packages ($lock) ..."
  # --no-deps: the lock holds everything; what it leaves out on purpose must not be asked for
  "$venv/bin/python" -m pip install -qq --disable-pip-version-check --no-deps -r "$lock"
  "$venv/bin/python" -m pip install -qq --disable-pip-version-check --no-deps --no-build-isolation -e .
  fingerprint > "$stamp"
fi
