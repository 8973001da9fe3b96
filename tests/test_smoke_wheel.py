"""The smoke test of the wheel; a stand-in for Python replaces building and installing."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SCRIPT = ROOT / "scripts" / "smoke-wheel.sh"
NAMED_NOWHERE = {"all", "dev", "docs", "mutate", "sim", "testing"}  # extras that no message of a command names

PYTHON = """\
#!/bin/sh
echo "$PWD: python $*" >> "{log}"
case "$1 $2" in
"-m build") case "$*" in *annexes*) ;; *) {build} ;; esac ;;
"-m venv") mkdir -p "$3/bin" && cp "$0" "$3/bin/python" && cp "{command}" "$3/bin/tactile-loc" ;;
"-m json.tool") exec "{python}" "$@" ;;
esac
"""
BUILDS = "[ -d source/tactile_loc ] && [ -d source/cli ] && touch dist/tactile_loc-1-py3-none-any.whl dist/x.tar.gz"
COMMAND = """\
#!/bin/sh
echo "$PWD: tactile-loc $*" >> "{log}"
refuse() {{
    echo "error: pip install 'tactile-loc[$1]' or pip install ./plugins_contrib/tactile-loc-$1" >&2
    exit {refusal}
}}
case "$*" in
doctor) exit {doctor} ;;
"run --out result") mkdir -p result && echo '{result}' > result/result.json && echo picture > result/result.png ;;
--version) ;;
--help) echo "Commands of tactile-loc-app, Commands of tactile-loc-benchmark" && \
    echo "Commands of tactile-loc-inspect, Commands of tactile-loc-library" && \
    echo "Commands of tactile-loc-test-object, Commands of tactile-loc-touchability" ;;
*--camera*) refuse camera ;;
benchmark*) refuse benchmark ;;
*--finger*) refuse clearance ;;
*faiss*) refuse faiss ;;
*kiss-icp*) refuse kiss ;;
*"--refiner icp"*) refuse icp ;;
*.3mf*) refuse meshes ;;
*raycast*|*pyrender*) refuse render ;;
inspect*) refuse inspect ;;
library*) refuse library ;;
test-object*) refuse test-object ;;
touchability*) refuse touchability ;;
*moco*) refuse learned ;;
replay*) refuse recordings ;;
*.step*) refuse step ;;
sweep*) refuse sweep ;;
*empty.mp4*) refuse camera ;;
*--rerun*) refuse view ;;
app) refuse app ;;
esac
"""


@pytest.fixture
def smoke(tmp_path: Path):
    """Return a function that runs the script with stand-ins; it returns the process and the lines of its log."""
    log = tmp_path / "log"
    (tmp_path / "temporary").mkdir()

    def run(build: str = BUILDS, **given: object) -> tuple[subprocess.CompletedProcess, list[str]]:
        given = {"doctor": 0, "result": "{}", "refusal": 2, **given}
        (tmp_path / "command").write_text(COMMAND.format(log=log, **given))
        (tmp_path / "command").chmod(0o755)
        python = tmp_path / "python"
        python.write_text(PYTHON.format(log=log, build=build, command=tmp_path / "command", python=sys.executable))
        python.chmod(0o755)
        environment = {**os.environ, "TMPDIR": str(tmp_path / "temporary"), "PYTHONPATH": "somewhere"}
        done = subprocess.run([SCRIPT, "./python"], cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert list((tmp_path / "temporary").iterdir()) == []  # the script deletes its temporary files
        return done, log.read_text().splitlines()

    return run


def test_the_script_builds_installs_and_runs_outside_the_sources(smoke):
    done, ran = smoke()
    assert done.returncode == 0, done.stderr
    assert "works" in done.stdout.splitlines()[-1]
    folders, lines = zip(*(line.split(": ", 1) for line in ran), strict=True)
    assert not [folder for folder in folders if Path(folder).is_relative_to(ROOT)]
    assert lines[0] == "python -m build --no-isolation --outdir dist source"
    assert lines[1:3] == ("python -V", "python -m venv venv")
    assert lines[3].endswith(f"-c {ROOT}/constraints.txt dist/tactile_loc-1-py3-none-any.whl")
    commands = [line for line in lines if line.startswith("tactile-loc ")]
    assert commands[:3] == ["tactile-loc --version", "tactile-loc doctor", "tactile-loc run --out result"]


def test_each_extra_that_a_message_names_is_tried_without_it():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    tried = re.findall(r"^needs (\w+) ", SCRIPT.read_text(), re.MULTILINE)
    assert sorted(set(tried)) == sorted(set(extras) - NAMED_NOWHERE)


def test_each_failure_ends_the_script(smoke):
    done, ran = smoke(build="echo no compiler; exit 1")
    assert (done.returncode, len(ran)) == (1, 1)
    assert "no compiler" in done.stderr
    for failing in ({"doctor": 1}, {"result": ""}, {"result": "not json"}, {"refusal": 0}, {"refusal": 1}):
        done, _ = smoke(**failing)
        assert done.returncode != 0, failing
        assert "works" not in done.stdout


def test_continuous_integration_runs_all_its_checks():
    lines = (ROOT / ".ci" / "run").read_text().splitlines()
    *checks, fuzz = lines[-5:]
    assert checks == [
        "make test",
        ".venv/bin/python scripts/processors.py --by-commit",
        "make test-slow",
        "make --jobs 2 --output-sync=line smoke docs",
    ]
    assert fuzz.startswith(".venv/bin/python scripts/fuzz.py --inputs 100 ")
