"""`tactile-loc new-plugin` and the templates of its packages."""

from __future__ import annotations
