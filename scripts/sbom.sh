#!/bin/sh
# Lists the packages that the wheel installs: builds it, installs it with the pinned versions into a fresh environment, and
# writes that environment as a CycloneDX bill of materials. Usage:
#
#     scripts/sbom.sh PYTHON OUT.json
set -eu

tree=$(cd "$(dirname "$0")/.." && pwd)
python=$(command -v "${1:-$tree/.venv/bin/python}")
out=${2:-$tree/out/sbom.cdx.json}
case $out in /*) ;; *) out=$PWD/$out ;; esac
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
trap 'exit 130' INT TERM

echo "sbom: building the wheel"
mkdir "$place/source"
(cd "$tree" && cp -R pyproject.toml README.md LICENSE tactile_loc cli "$place/source")
"$python" -m build --no-isolation --wheel --outdir "$place/dist" "$place/source" >"$place/log" 2>&1 || {
    cat "$place/log" >&2
    exit 1
}
echo "sbom: installing it into a fresh environment, a minute or two"
"$python" -m venv "$place/venv"
"$place/venv/bin/python" -m pip install -qq --disable-pip-version-check -c "$tree/constraints.txt" "$place"/dist/*.whl
"$python" -m venv "$place/tools"
"$place/tools/bin/python" -m pip install -qq --disable-pip-version-check cyclonedx-bom
mkdir -p "$(dirname "$out")"
"$place/tools/bin/cyclonedx-py" environment --output-reproducible --of JSON -o "$out" "$place/venv"
echo "sbom: $out"
