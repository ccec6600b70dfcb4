#!/bin/sh
# setup.sh [EXTRAS]: makes .venv and installs the checkout into it with these extras of pyproject.toml,
# in the versions of constraints.txt. Safe to run again; asks nothing. PYTHON picks the interpreter.
set -eu
cd "$(dirname "$0")/.."
extras=${1-}

say() { printf 'setup: %s\n' "$*" >&2; }

if [ "$(id -u)" = 0 ]; then as_root=""
elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then as_root="sudo -n"
else as_root="none"
fi

# apt_install PACKAGE...: succeeds only if they are installed afterwards
apt_install() {
    [ "$as_root" != none ] && command -v apt-get >/dev/null 2>&1 || return 1
    say "installing $* with apt"
    export DEBIAN_FRONTEND=noninteractive
    $as_root apt-get install -y -q "$@" >/dev/null 2>&1 && return 0
    $as_root apt-get update -q >/dev/null 2>&1 || true
    $as_root apt-get install -y -q "$@" >/dev/null 2>&1
}

find_python() {
    for candidate in ${PYTHON:-} python3.11 python3 python3.12 python3.13 /usr/bin/python3; do
        if "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            # Debian ships venv without ensurepip until python3-venv is there
            if "$candidate" -c 'import ensurepip, venv' 2>/dev/null; then
                echo "$candidate"; return 0
            fi
        fi
    done
    return 1
}

if ! .venv/bin/python -m pip --version >/dev/null 2>&1; then
    if ! python=$(find_python); then
        apt_install python3-venv python3 || true
        python=$(find_python) || {
            say "no Python 3.11 or newer with venv. Remedy: apt-get install python3-venv, or PYTHON=/path make setup"
            exit 1
        }
    fi
    say "making .venv with $("$python" --version)"
    rm -rf .venv
    "$python" -m venv .venv
fi

pip=".venv/bin/python -m pip --disable-pip-version-check --no-input -q"
say "installing calm-edge${extras:+[$extras]} (a few minutes the first time)"
$pip install -c constraints.txt -e ".${extras:+[$extras]}" >.venv/install.log 2>&1 || { cat .venv/install.log >&2; exit 1; }

if ! .venv/bin/python -c 'import systemd.daemon' 2>/dev/null; then
    header=$(.venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("include"))')/Python.h
    if ! command -v gcc >/dev/null || ! pkg-config --exists libsystemd 2>/dev/null; then
        apt_install gcc pkg-config libsystemd-dev || true
    fi
    [ -f "$header" ] || apt_install python3-dev || true
    $pip install -c constraints.txt -e ".[systemd]" >/dev/null 2>&1 || say "systemd-python is missing: no watchdog \
and no readiness under systemd; all else works. Remedy: apt-get install gcc pkg-config libsystemd-dev python3-dev && make setup"
fi

say "done: .venv/bin/calm-edge --help ($(du -smL .venv | cut -f1) MB)"
