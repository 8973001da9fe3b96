import errno
import os
import signal
from pathlib import Path

import numpy as np
import pytest
from kill_steps import killed_at_every_step
from message_helpers import missing, naming
from store_helpers import KEY, Five, contents, flip, folder_of, reference, run_python

from tactile_loc import StageKey, StageStore
from tactile_loc.core.runtime.errors import StoreError
from tactile_loc.store.artifact import MANIFEST, Artifact
from tactile_loc.store.workspace import Workspace, WorkspaceCheckpoints


@pytest.mark.parametrize("error", [KeyboardInterrupt(), RuntimeError("out of luck")])
def test_an_interrupted_build_is_resumed(store, tmp_path, error):
    with pytest.raises(type(error)):
        store.build(KEY, Five(stop_at=2, error=error))
    assert store.get(KEY) is None
    assert not folder_of(store).exists()
    assert store.built == []
    five = Five()
    artifact = StageStore(store.root).build(KEY, five)
    assert five.computed == [2, 3, 4]
    assert contents(artifact.path) == reference(tmp_path)
    assert not artifact.path.with_suffix(".partial").exists()


@pytest.mark.parametrize(
    ("name", "damage", "computed"),
    [
        *(
            ("piece1.npy", damage, [1, 4])
            for damage in (lambda path: os.truncate(path, 300), Path.unlink, flip("", -1))
        ),
        (".pieces.json", lambda path: os.truncate(path, 20), [0, 1, 2, 3, 4]),  # the record of all pieces
    ],
)
def test_a_damaged_piece_is_computed_again(store, tmp_path, name, damage, computed):
    with pytest.raises(KeyboardInterrupt):
        store.build(KEY, Five(stop_at=4))
    damage(folder_of(store).with_suffix(".partial") / name)
    five = Five()
    assert contents(store.build(KEY, five).path) == reference(tmp_path)
    assert five.computed == computed


def test_unused_old_pieces_are_dropped(store):
    with pytest.raises(KeyboardInterrupt):
        store.build(KEY, Five(stop_at=2))
    assert store.build(KEY, lambda workspace: workspace.save_json("x", 1)).names == ("x.json",)
    assert contents(folder_of(store)) == {"x.json": b"1\n"}


def test_a_finished_training_reads_its_last_checkpoint_and_does_not_keep_it(store):
    def interrupted(workspace: Workspace) -> None:
        checkpoints = WorkspaceCheckpoints(workspace)
        assert checkpoints.load() is None
        for epoch in (4, 5):
            checkpoints.save(lambda path, epoch=epoch: path.write_text(f"epoch {epoch}"))
        raise KeyboardInterrupt

    def resumed(workspace: Workspace) -> None:
        checkpoint = WorkspaceCheckpoints(workspace).load()
        assert checkpoint is not None
        workspace.save_json("state", checkpoint.read_text())

    def uninterrupted(workspace: Workspace) -> None:
        WorkspaceCheckpoints(workspace).save(lambda path: path.write_text("epoch 5"))
        workspace.save_json("state", "epoch 5")

    with pytest.raises(KeyboardInterrupt):
        store.build(KEY, interrupted)
    other = StageKey("bank", 2, {})
    for artifact in (store.build(KEY, resumed), store.build(other, uninterrupted)):
        assert artifact.load_json("state") == "epoch 5"
        assert artifact.names == ("state.json",)


def test_saved_files_of_an_interrupted_build_are_reused(store):
    def interrupted(workspace: Workspace) -> None:
        workspace.save_file("notes.txt", lambda path: path.write_text("mine"))
        workspace.save_array("poses", np.arange(3), packed=True)
        raise KeyboardInterrupt

    def resumed(workspace: Workspace) -> None:
        assert workspace.load_file("notes.txt") is not None
        np.testing.assert_array_equal(workspace.load("poses"), np.arange(3))
        assert workspace.load_file("none.txt") is workspace.load("none") is None

    with pytest.raises(KeyboardInterrupt):
        store.build(KEY, interrupted)
    artifact = store.build(KEY, resumed)
    assert artifact.names == ("notes.txt", "poses.npz")
    np.testing.assert_array_equal(artifact.load_array("poses"), np.arange(3))


def test_a_kill_between_record_and_rename_keeps_the_earlier_checkpoint(store, monkeypatch):
    real = os.replace

    def killed(source: Path, target: Path) -> None:
        if Path(target).name == "x.npy":
            raise KeyboardInterrupt
        real(source, target)

    def make(workspace: Workspace) -> None:
        workspace.save_array("x", np.array([1]))
        monkeypatch.setattr(os, "replace", killed)
        workspace.save_array("x", np.array([2]))

    with pytest.raises(KeyboardInterrupt):
        store.build(KEY, make)
    monkeypatch.undo()
    artifact = store.build(KEY, lambda workspace: workspace.load("x"))
    np.testing.assert_array_equal(artifact.load_array("x"), [1])


@pytest.mark.slow
def test_a_build_killed_at_its_end_is_not_repeated(store, tmp_path):
    def make(workspace: Workspace) -> None:
        with (tmp_path / "made.txt").open("a") as file:
            file.write("x")
        for name in ("a", "b"):
            workspace.save_array(name, np.arange(3), keep=name == "b")

    ended = 0
    for _ in killed_at_every_step(lambda: store.build(KEY, make)):
        finished = [*store.root.glob(f"*/*/{MANIFEST}")]
        made = len((tmp_path / "made.txt").read_text()) if (tmp_path / "made.txt").exists() else 0
        artifact = store.build(KEY, make)
        assert artifact.names == ("b.npy",)
        assert sorted(path.name for path in artifact.path.iterdir()) == ["b.npy", MANIFEST]
        ended += len(finished)
        assert len((tmp_path / "made.txt").read_text()) == made + (not finished)
        store.remove(KEY.digest)
    assert ended > 4


KILLED = """
import os, signal, sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from store_helpers import KEY, Five
from tactile_loc.store.store import StageStore

class Killed(Five):
    def piece(self, i):
        if i == 3:
            (self.path / "piece3.npy").write_bytes(b"half written")
            os.kill(os.getpid(), signal.SIGKILL)
        return super().piece(i)

    def __call__(self, workspace):
        self.path = workspace.path
        super().__call__(workspace)

StageStore(Path(sys.argv[1])).build(KEY, Killed())
"""


def test_a_killed_build_is_resumed(store, tmp_path):
    process = run_python(KILLED, store.root, Path(__file__).parent)
    process.communicate(timeout=600)
    assert process.returncode == -signal.SIGKILL
    assert store.get(KEY) is None
    five = Five()
    assert contents(store.build(KEY, five).path) == reference(tmp_path)
    assert five.computed == [3, 4]


# Disk errors


@pytest.mark.parametrize("call", ["fsync", "replace", "rename"])
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EACCES, errno.EROFS])
def test_a_disk_error_is_explained_and_the_next_build_succeeds(store, tmp_path, monkeypatch, call, code):
    def refuse(*_: object) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, call, refuse)
    with pytest.raises(StoreError) as caught:
        store.build(KEY, Five())
    monkeypatch.undo()
    message = str(caught.value)
    assert not missing(message, store.root, os.strerror(code), "TACTILE_LOC_STORE", "`store`")
    assert ("free" in message) == (code == errno.ENOSPC)
    assert not folder_of(store).exists()
    assert contents(store.build(KEY, Five()).path) == reference(tmp_path)


def fail_in_words(_: Path) -> None:
    raise RuntimeError("Error while serializing: I/O error: No space left on device (os error 28)")


@pytest.mark.parametrize(
    ("write", "reason"),
    [
        (lambda _: Path("/dev/full").write_bytes(b"x" * 9000), "No space left"),
        (fail_in_words, "No space left"),
        (lambda _: np.zeros(10**5).tofile("/dev/full"), "incomplete"),
    ],
)
def test_a_full_device_is_refused_and_the_next_build_succeeds(store, tmp_path, write, reason):
    with pytest.raises(StoreError, match=naming("weights.bin", "bank", reason, "TACTILE_LOC_STORE", "`store`")):
        store.build(KEY, lambda workspace: workspace.save_file("weights.bin", write))
    assert contents(store.build(KEY, Five()).path) == reference(tmp_path)


def test_pieces_survive_a_manifest_that_cannot_be_written(store, monkeypatch):
    real = os.replace

    def refuse(source: Path, target: Path) -> None:
        if Path(target).name == "manifest.json":
            raise OSError(errno.ENOSPC, "full")
        real(source, target)

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(StoreError):
        store.build(KEY, Five())
    monkeypatch.undo()
    five = Five()
    store.build(KEY, five)
    assert five.computed == []


@pytest.mark.parametrize("blocked", ["store", "store/bank", "store/bank/{short}.partial"])
def test_a_file_in_place_of_a_folder_is_refused(store, blocked):
    path = store.root.parent / blocked.format(short=KEY.short)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("in the way")
    assert store.get(KEY) is None
    with pytest.raises(StoreError, match=naming("bank", "folder", "TACTILE_LOC_STORE", "`store`")):
        store.build(KEY, Five())
    path.unlink()
    assert isinstance(store.build(KEY, Five()), Artifact)


def test_errors_of_make_pass_through(store):
    def make(workspace: Workspace) -> None:
        workspace.save_array("x", np.load("/nowhere/x.npy"))

    with pytest.raises(FileNotFoundError):
        store.build(KEY, make)
