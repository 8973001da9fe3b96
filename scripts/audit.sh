#!/bin/sh
# Looks for known vulnerabilities of the pinned packages, with pip-audit in a separate environment. Usage:
#
#     scripts/audit.sh PYTHON
#
# It needs the internet. The exit status is 1 if a package could not be looked up.
set -eu

tree=$(cd "$(dirname "$0")/.." && pwd)
python=$(command -v "${1:-$tree/.venv/bin/python}")
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
trap 'exit 130' INT TERM

echo "audit: installing pip-audit"
"$python" -m venv "$place/venv"
"$place/venv/bin/python" -m pip install -qq --disable-pip-version-check pip-audit
echo "audit: looking up $(grep -c == "$tree/constraints.txt") packages"
"$place/venv/bin/pip-audit" --requirement "$tree/constraints.txt" --no-deps --disable-pip >"$place/found" 2>"$place/said" || status=$?
unknown=$(grep -c 'could not be audited' "$place/found" || true)
grep -v 'could not be audited' "$place/found" || true
if [ "$unknown" -gt 0 ]; then
    echo "audit: $unknown packages could not be looked up; is there no internet?" >&2
    exit 1
fi
if [ "${status:-0}" -ne 0 ]; then
    cat "$place/said" >&2
    exit "$status"
fi
echo "audit: no known vulnerability"
