"""The command starts quickly: heavy libraries are imported only when they are needed."""

import json
import subprocess
import sys

import pytest
from cli_helpers import HANGS_S

HEAVY = {"torch", "open3d", "trimesh", "scipy", "matplotlib", "numba", "numpy", "faiss", "pyrender", "PIL"}
PROBE = """
import json, sys
from tactile_loc_cli.main import main
try:
    main()
except SystemExit as end:
    print(json.dumps([end.code, sorted({name.partition(".")[0] for name in sys.modules})]), file=sys.stderr)
"""


@pytest.mark.parametrize("line", ["--help", "run --help", "plugins", "plugins grid", "objects", "--version"])
def test_light_commands_import_no_heavy_library(line):
    done = subprocess.run([sys.executable, "-c", PROBE, *line.split()], capture_output=True, text=True, timeout=HANGS_S)
    code, modules = json.loads(done.stderr)
    assert code == 0
    assert done.stdout
    assert HEAVY & set(modules) == set()
