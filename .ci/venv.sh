#!/bin/sh
# Make a virtual environment with pip at $1. Debian's python3 comes without ensurepip, so there are other ways than one.
set -u
venv=$1

fits() { "$1" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 14))' 2>/dev/null; }
works() { "$venv/bin/python" -m pip --version >/dev/null 2>&1; }

python=
for candidate in ${PYTHON:-python3 python3.13 python3.12 python3.14 python3.11}; do
    if fits "$candidate"; then python=$candidate; break; fi
done
if [ -z "$python" ]; then
    echo "Python 3.11 to 3.14 is needed and none was found; install it, or say where it is: make PYTHON=/path/to/python3" >&2
    exit 1
fi

as_root() { if [ "$(id -u)" = 0 ]; then "$@"; else sudo -n "$@"; fi; }

"$python" -m venv "$venv" >/dev/null 2>&1 && works && exit 0
rm -rf "$venv"
"$python" -m virtualenv "$venv" >/dev/null 2>&1 && works && exit 0
rm -rf "$venv"
"$python" -m venv --without-pip "$venv" >/dev/null 2>&1 &&
    "$python" -m pip --python "$venv/bin/python" install --quiet pip >/dev/null 2>&1 && works && exit 0
rm -rf "$venv"
if command -v apt-get >/dev/null 2>&1; then
    echo "$python has no ensurepip; installing Debian's python3-venv"
    { as_root apt-get install -y python3-venv || { as_root apt-get update && as_root apt-get install -y python3-venv; }; } \
        >/dev/null 2>&1
    "$python" -m venv "$venv" >/dev/null 2>&1 && works && exit 0
    rm -rf "$venv"
fi
echo "$python cannot make a virtual environment; on Debian and Ubuntu: sudo apt install python3-venv, then again" >&2
exit 1
