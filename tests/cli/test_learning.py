"""The learned encoder from the command line: reproducible tables, and errors when it cannot learn."""

import contextlib
import re
import shutil
from pathlib import Path

import pytest
from cli_helpers import FLAT_SENSOR, SURE, TINY, succeed
from tactile_loc_cli.main import app
from typer.testing import CliRunner

torch = pytest.importorskip("torch")
save_file = pytest.importorskip("safetensors.torch").save_file

from tactile_loc.plugins.encoders.moco import recipe, training  # noqa: E402

OPTIONS = ("epochs=2", "queries=64", "batch=32", "channels=4")
MOCO = ["--encoder", "moco", *(word for option in OPTIONS for word in ("-o", f"encoder.{option}"))]
PIXEL = ["--object", "pin", *TINY, "--sensor", "flat.toml"]
PIN = [*PIXEL, *MOCO]
PAPER = ["paper", *PIN, *SURE, "--encoder", "pixel", "--refiner", "none", "--count", 2]


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a sensor of few pixels, and a store with all stages that need no training."""
    folder = tmp_path_factory.mktemp("prepared")
    (folder / "flat.toml").write_text(FLAT_SENSOR)
    with contextlib.chdir(folder):
        done = CliRunner().invoke(app, ["build", *PIXEL, "--store", "store"])
    assert done.exit_code == 0, done.stderr
    return folder


@pytest.fixture(autouse=True)
def stores(prepared: Path, cli) -> None:
    """Copy the sensor file, and make three copies of the prepared store."""
    shutil.copy(prepared / "flat.toml", ".")
    for name in ("whole", "stopped", "fresh"):
        shutil.copytree(prepared / "store", name)


@pytest.fixture(autouse=True)
def few_touches_to_validate_with(monkeypatch):
    monkeypatch.setattr(training, "VALIDATION_TOUCHES", 32)


def table(cli, folder: str) -> str:
    succeed(cli(*PAPER, "--store", folder, "--out", f"out-{folder}"))
    return (Path(f"out-{folder}") / "results.csv").read_text()


def interrupt_after_a_checkpoint(cli, monkeypatch, *words: object) -> None:
    """Run a command whose training is interrupted after its first checkpoint."""
    save = training.Trainer._checkpoint

    def save_and_stop(self):
        save(self)
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(training.Trainer, "_checkpoint", save_and_stop)
        assert cli(*words).exit_code == 130


@pytest.mark.slow
def test_an_interrupted_training_gives_the_same_table(cli, monkeypatch):
    whole = table(cli, "whole")
    assert {line.split(",")[1] for line in whole.splitlines()[1:]} == {"moco", "pixel"}

    interrupt_after_a_checkpoint(cli, monkeypatch, *PAPER, "--store", "stopped", "--out", "out-stopped")
    assert not Path("out-stopped/results.csv").exists()
    steps = []
    step = training.Trainer._step
    monkeypatch.setattr(training.Trainer, "_step", lambda self, *a: steps.append(1) or step(self, *a))
    assert table(cli, "stopped") == whole
    assert len(steps) == 2 * recipe.PRESETS["cpu"].repeats  # only the steps of the second epoch


def build(cli, *words: object):
    return cli("build", *PIN, "--store", "fresh", *words)


@pytest.mark.slow
def test_a_truncated_stored_encoder_is_trained_again(cli):
    done = build(cli)
    assert done.exit_code == 0
    assert re.search(r"^note: .*\bpin\b.*minutes$", done.stderr, re.MULTILINE)
    (stored,) = Path("fresh").glob("encoder/*/encoder.safetensors")
    whole = stored.read_bytes()
    stored.chmod(0o644)
    stored.write_bytes(whole[:-100])
    for bank in Path("fresh").glob("bank/*/manifest.json"):
        bank.unlink()
    done = build(cli)
    assert done.exit_code == 0, done.stderr
    assert stored.read_bytes() == whole


WHOLE = ["--object", "pin", "--grid", "whole", "-o", "grid.directions=100", "--sensor", "flat.toml", *SURE, *MOCO]


@pytest.mark.slow
def test_build_trains_the_encoder_of_a_whole_object(cli):
    words = ["build", *WHOLE, "--store", "fresh"]
    first, again = cli(*words), cli(*words)
    assert first.exit_code == again.exit_code == 0, first.stderr + again.stderr
    assert re.search(r"^encoder \(.*\): built$", first.stdout, re.MULTILINE)
    assert re.search(r"^encoder \(.*\): reused$", again.stdout, re.MULTILINE)
    seeded = cli(*words, "-o", "encoder.seed=1").stdout
    assert len(re.findall(r"^encoder \(.*\): built$", seeded, re.MULTILINE)) == 1
