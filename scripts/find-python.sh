#!/bin/sh
# Prints the path of the Python that the virtual environment is made with: $PYTHON if that is set, else the first of
# python3.11, python3.12 and python3 that is 3.11 or newer and can make virtual environments. If none can make them,
# the first that is new enough, for system-packages.sh to complete.
set -eu

new_enough() { "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; }
makes_venvs() { "$1" -c 'import ensurepip, venv' >/dev/null 2>&1; }
# Inside an active virtual environment (perhaps the one about to be renewed), the Python beneath it.
show() { "$1" -c 'import sys; print(getattr(sys, "_base_executable", "") or sys.executable)'; }

if [ -n "${PYTHON:-}" ]; then
    new_enough "$PYTHON" && show "$PYTHON" && exit
    echo "PYTHON=$PYTHON is not a Python of 3.11 or newer: give the path of one, or leave PYTHON unset." >&2
    exit 1
fi

incomplete=
for name in python3.11 python3.12 python3; do
    new_enough "$name" || continue
    makes_venvs "$name" && show "$name" && exit
    incomplete=${incomplete:-$name}
done
[ -n "$incomplete" ] && show "$incomplete" && exit
echo "tactile-loc needs Python 3.11 or newer, and none of python3.11, python3.12 and python3 is: install one" \
    "(Debian, Ubuntu: apt-get install python3.11 python3.11-venv) or name it: make setup PYTHON=/path/to/python." >&2
exit 1
