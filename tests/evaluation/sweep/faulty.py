"""A distribution whose refiners raise an error or kill their process; sweeps must survive both."""

from pathlib import Path

HOOK = """
from tactile_loc.slots.registry import ComponentSpec, hookimpl

@hookimpl
def tactile_loc_components():
    names = {"raising": "Raising", "grumbling": "Grumbling", "lethal": "Lethal", "telling": "Telling"}
    parts = {name: f"sweep_faults_parts:{kind}" for name, kind in names.items()}
    return [ComponentSpec("refiner", name, part, "made up", interface=2) for name, part in parts.items()]
"""

PARTS = '''
import os, signal, time
from pathlib import Path

from tactile_loc.core.runtime.errors import TouchError
from tactile_loc.plugin import ComponentOptions, RefinedPose, Refiner

class Raising(Refiner):
    def refine(self, touch, candidate, scene):
        raise ValueError("nothing works\\nat all")

class Grumbling(Refiner):
    def refine(self, touch, candidate, scene):
        raise TouchError("this touch cannot be refined; take another")

class Telling(Refiner):
    """Says what its process is like."""
    def refine(self, touch, candidate, scene):
        names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
        raise ValueError(" ".join(os.environ.get(name, "-") for name in names))

class Lethal(Refiner):
    """Kills its process as often as it has not yet done so; the file `tally` has a byte for each time."""
    class Options(ComponentOptions):
        tally: str
        deaths: int = 1
    def refine(self, touch, candidate, scene):
        tally = Path(self.options.tally)
        if not tally.exists() or tally.stat().st_size < self.options.deaths:
            with tally.open("a") as file:
                file.write("x")
            os.kill(os.getpid(), signal.SIGKILL)
        return RefinedPose(candidate.T_sensor_object, 1.0, True, 0)
'''


def install(site: Path) -> Path:
    """Install the distribution into a folder for PYTHONPATH."""
    info = site / "sweep_faults-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: sweep-faults\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[tactile_loc]\nsweep-faults = sweep_faults\n")
    (site / "sweep_faults.py").write_text(HOOK)
    (site / "sweep_faults_parts.py").write_text(PARTS)
    return site
