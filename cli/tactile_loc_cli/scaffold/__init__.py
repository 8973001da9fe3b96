"""Writes packages for new components: what `tactile-loc new-plugin` does."""

from __future__ import annotations
