#!/bin/sh
# Tries the wheel as a user gets it: builds the source distribution and from it the wheel, installs the wheel into a fresh
# virtual environment outside the source tree, and locates a demo object there. Usage:
#
#     scripts/smoke-wheel.sh [PYTHON [FRESH]]
#
# PYTHON must have build, setuptools and wheel, as in the development environment; the build downloads nothing. FRESH is
# the Python of the fresh environment, 3.11 to 3.13; by default, it is PYTHON. The wheel's dependencies are those of
# constraints.txt, without any extra. So each command that needs an extra must name its install line.
set -eu

say() { echo "smoke: $*"; }
give_up() {
    echo "smoke: $*" >&2
    exit 1
}

tree=$(cd "$(dirname "$0")/.." && pwd)
python=$(command -v "${1:-$tree/.venv/bin/python}") || give_up "there is no ${1:-.venv}: run make setup first"
case $python in /*) ;; *) python=$PWD/$python ;; esac
fresh=$(command -v "${2:-$python}") || give_up "there is no Python $2"
case $fresh in /*) ;; *) fresh=$PWD/$fresh ;; esac
unset PYTHONPATH PYTHONHOME

place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
trap 'exit 130' INT TERM
cd "$place"

# The build uses a copy, without files of an earlier build or an editable installation.
say "building the wheel"
mkdir source dist run
(cd "$tree" && cp -R pyproject.toml README.md LICENSE tactile_loc cli "$place/source")
find source -name __pycache__ -prune -exec rm -rf {} + -o -name '*.egg-info' -prune -exec rm -rf {} +
"$python" -m build --no-isolation --outdir dist source >build.log 2>&1 || give_up "it cannot be built: $(cat build.log)"
wheel=$(echo dist/*.whl)
say "built $(basename "$wheel") and $(basename dist/*.tar.gz)"

say "installing it into a fresh virtual environment of $("$fresh" -V), a minute or two"
"$fresh" -m venv venv
venv/bin/python -m pip install -qq --disable-pip-version-check -c "$tree/constraints.txt" "$wheel"

cd run
export TACTILE_LOC_STORE="$place/store"
run() {
    say "tactile-loc $*"
    ../venv/bin/tactile-loc "$@"
}
../venv/bin/python -c 'import sys, tactile_loc; sys.exit(not tactile_loc.__file__.startswith(sys.prefix))' ||
    give_up "another tactile_loc than the installed one is imported"
run --version
run doctor
run run --out result
[ -s result/result.json ] || give_up "tactile-loc run wrote no result.json"
../venv/bin/python -m json.tool result/result.json /dev/null || give_up "result.json is not JSON"
[ -s result/result.png ] || give_up "tactile-loc run drew no result.png"

# Without a library or a package, a command must end with exit code 2 and the words that install it.
refuses() {
    words=$1
    shift
    say "tactile-loc $* (without: $words)"
    code=0
    ../venv/bin/tactile-loc "$@" >needs.log 2>&1 || code=$?
    grep -qF "pip install $words" needs.log && [ "$code" = 2 ] ||
        give_up "tactile-loc $* ended with exit code $code and does not name $words: $(cat needs.log)"
}
needs() { # an extra, and a command that needs it
    extra=$1
    shift
    refuses "'tactile-loc[$extra]'" "$@"
}
annex() { refuses "./plugins_contrib/tactile-loc-$1" "$1"; } # a command of a package in plugins_contrib
touch empty.3mf empty.mcap empty.mp4 empty.step empty.stl
annex app
annex benchmark
annex inspect
annex library
annex test-object
annex touchability
needs camera live --camera 0 --object hook --port 0
needs camera calibrate empty.mp4 --ball-radius 3 --mm-per-px 0.06 --out refused
needs clearance next-touch result --around 3 --finger 32x28x24mm --out refused
needs faiss run --matcher faiss --out refused
needs icp run --refiner icp --out refused
needs kiss run --refiner kiss-icp --out refused
needs learned run --encoder moco --out refused
needs meshes run --object empty.3mf --units mm --touch touch.npz --out refused
needs recordings replay empty.mcap --image-topic /gel/image --object hook
needs render run --renderer raycast --out refused
needs render run --renderer pyrender --out refused
needs step run --object empty.step --units mm --touch touch.npz --out refused
needs sweep sweep --object hook --scheduler tcp://127.0.0.1:1 --out refused
needs view run --rerun refused.rrd --out refused

# The annexes are built and installed from a copy of the tree, without their libraries, and add their commands.
for folder in "$tree"/plugins_contrib/tactile-loc-app "$tree"/plugins_contrib/tactile-loc-benchmark \
    "$tree"/plugins_contrib/tactile-loc-inspect "$tree"/plugins_contrib/tactile-loc-library \
    "$tree"/plugins_contrib/tactile-loc-test-object "$tree"/plugins_contrib/tactile-loc-touchability; do
    [ -e "$folder/pyproject.toml" ] || continue
    name=$(basename "$folder")
    say "building and installing $name"
    cp -R "$folder" "$place/$name"
    "$python" -m build --no-isolation --wheel --outdir "$place/annexes" "$place/$name" >build.log 2>&1 ||
        give_up "$name cannot be built: $(cat build.log)"
    ../venv/bin/python -m pip install -qq --no-index --no-deps "$place/annexes/$(echo "$name" | tr - _)"-*.whl
    ../venv/bin/tactile-loc --help | grep -qF "Commands of $name" || give_up "$name adds no commands"
done
say "the wheel works"
