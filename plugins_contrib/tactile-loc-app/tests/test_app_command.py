"""`tactile-loc app` serves its page on this machine until Ctrl-C: the commands of docs/app.md."""

import signal
from urllib.request import urlopen

import pytest
from cli_helpers import HANGS_S, assert_refused, command, start_process

pytest.importorskip("viser")


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM])
def test_the_page_is_served_until_a_signal_and_leaves_no_files(store_folder, tmp_path, monkeypatch, ending):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    process = start_process(command("app", "--object", "pin", "--port", "0"), tmp_path, store_folder)
    try:
        url = next(word for word in process.stdout.readline().split() if word.startswith("http"))
        assert url.startswith("http://127.0.0.1:")
        with urlopen(url, timeout=HANGS_S) as page:
            assert page.status == 200
        assert list(tmp_path.glob("tactile-loc-app-*"))
        process.send_signal(ending)
        _, errors = process.communicate(timeout=HANGS_S)
    finally:
        process.kill()
    assert process.returncode == 0, errors
    assert "Traceback" not in errors
    assert list(tmp_path.iterdir()) == []


def test_a_wrong_object_is_refused_before_the_page_is_served(cli):
    assert_refused(cli("app", "--object", "missing.stl"), "missing.stl")
