"""docs/programs.md: the server answers over HTTP, and the processes find the poses that one process finds."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from http.server import ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from tactile_loc import Localizer, StageStore, load_object, write_touch

PAGE = Path(__file__).parents[1] / "docs" / "programs.md"
SERVICE, PROCESSES = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.DOTALL | re.MULTILINE)


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, store: StageStore) -> Path:
    """A folder with the mesh that the page names."""
    mesh = load_object("pin").mesh
    trimesh.Trimesh(mesh.vertices_m * 1e3, mesh.faces, process=False).export(tmp_path / "part.stl")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TACTILE_LOC_STORE", str(store.root))
    return tmp_path


@pytest.fixture
def service(workplace: Path) -> Iterator[tuple[str, Localizer]]:
    """The address of the page's server, and its localizer."""
    made: dict[str, Any] = {"__name__": "service"}
    exec(compile(SERVICE, str(PAGE), "exec"), made)
    made["Service"].log_message = lambda *_: None
    server = ThreadingHTTPServer(("127.0.0.1", 0), made["Service"])
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}", made["localizer"]
    server.shutdown()
    server.server_close()


def test_the_server_locates_touches_and_explains_errors(service, workplace):
    address, localizer = service
    write_touch(workplace / "touch.npz", touch := localizer.simulate(seed=3)[0])
    with urllib.request.urlopen(address, (workplace / "touch.npz").read_bytes(), timeout=60) as response:
        answer = json.load(response)
    best = localizer.localize(touch).best
    np.testing.assert_allclose(answer["hypotheses"][0]["pose"], best.T_sensor_object, atol=1e-6)
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(address, b"no touch", timeout=60)
    assert refused.value.code == 400
    assert json.load(refused.value)["error"]


@pytest.mark.slow
def test_the_processes_find_the_poses(workplace):
    (workplace / "program.py").write_text(PROCESSES + "    print(len(poses), *poses[7].ravel())\n")
    done = subprocess.run(
        [sys.executable, "program.py"], cwd=workplace, capture_output=True, text=True, timeout=300, check=True
    )
    count, *pose = map(float, done.stdout.split())
    localizer = Localizer.create("part.stl", units="mm")
    expected = localizer.localize(localizer.simulate(20)[7]).best.T_sensor_object
    assert count == 20
    np.testing.assert_array_equal(np.reshape(pose, (4, 4)), expected)
