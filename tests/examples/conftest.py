"""The example modules import each other by name, as when run.py starts them."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2] / "examples" / "insertion"))
