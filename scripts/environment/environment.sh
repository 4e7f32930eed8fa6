#!/bin/sh
# Makes the environment of the project in $VENV (default .venv), or finds it as it was left: quick when nothing changed.
# An argument says when kernels are compiled, as environment.py knows it.
# The Python is $PYTHON, or the newest usable one among 3.13 and 3.11 on PATH and among pyenv's versions.
set -eu
cd "$(dirname "$0")/../.."
venv=${VENV:-.venv}

# Prints MAJOR.MINOR of a Python that the project can use; fails for any other command.
usable_version() {
    "$1" -c '
import sys, venv, ensurepip
version = "%d.%d" % sys.version_info[:2]
if version not in ("3.13", "3.11") or sys.maxsize < 2**32:
    sys.exit(1)
print(version)' 2>/dev/null
}

find_python() {
    pyenv_versions=${PYENV_ROOT:-$HOME/.pyenv}/versions
    for wanted in 3.13 3.11; do
        for candidate in "python$wanted" python3 python "$pyenv_versions/$wanted".*/bin/python; do
            if [ "$(usable_version "$candidate" || true)" = "$wanted" ]; then
                command -v "$candidate"
                return 0
            fi
        done
    done
    return 1
}

if [ -n "${PYTHON:-}" ]; then
    if ! usable_version "$PYTHON" >/dev/null; then
        echo "RayBatch: PYTHON=$PYTHON cannot be used: it must be a 64-bit Python 3.13 or 3.11 with the venv module" >&2
        exit 1
    fi
    python=$PYTHON
elif [ -x "$venv/bin/python" ] && usable_version "$venv/bin/python" >/dev/null; then
    python=$venv/bin/python  # the one chosen before; environment.py knows where it came from
elif ! python=$(find_python); then
    echo "RayBatch: no usable Python found: install Python 3.13 or 3.11 (with its venv module), or name one with PYTHON=/path/to/python" >&2
    exit 1
fi
exec "$python" scripts/environment/environment.py "$venv" "$@"
