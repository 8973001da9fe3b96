"""The example modules import each other by name, as when run.py starts them."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2] / "examples" / "insertion"))
