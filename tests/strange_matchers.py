"""Matchers of third-party plugins, for the current, an earlier and a later plugin interface."""

from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np

from tactile_loc.plugin import Capabilities, ComponentSpec, Matcher, hookimpl, registry
from tactile_loc.slots import registry as module


class Plain(Matcher):
    """A matcher that takes no weights, and does not declare this."""

    def index(self, bank):
        self.bank = np.array(bank, np.float32)

    def scores(self, queries):
        return np.float32(-0.5) * ((queries[:, None] - self.bank) ** 2).sum(axis=-1)


class Listed(Plain):
    """A matcher that declares no support for weights."""

    capabilities = Capabilities(weights=False)


SPECS = {
    "listed": ComponentSpec("matcher", "listed", "strange_matchers:Listed", "cannot weigh", interface=2),
    "forgetful": ComponentSpec("matcher", "forgetful", "strange_matchers:Plain", "claims to weigh", interface=2),
    "behind": ComponentSpec("matcher", "behind", "strange_matchers:Listed", "of an earlier interface", interface=1),
    "ahead": ComponentSpec("matcher", "ahead", "strange_matchers:Listed", "of a later interface", interface=99),
}


class Stranger:
    """The entry point of a plugin that offers all these matchers."""

    name = value = "strange"
    group = module.PROJECT
    dist = SimpleNamespace(name="strange-matchers")

    def load(self) -> Any:
        return SimpleNamespace(tactile_loc_components=hookimpl(lambda: list(SPECS.values())))


@contextmanager
def installed() -> Iterator[None]:
    """Install all these matchers beside the built-in components."""
    found = [point for point in module.find_plugins() if module._is_built_in(point)]
    with patch.object(module, "find_plugins", lambda: [*found, Stranger()]):
        registry.cache_clear()
        yield
    registry.cache_clear()
