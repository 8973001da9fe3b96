"""The evidence for "none of these": touches that objects explain separately, but no object together.

An unknown object has features in common with known objects, such as edges of the same shape. So its touches are
explained separately, by one object or another, but hardly ever all by one object. Touches keep a misfit even
separately, because of noise. Noisier touches also lack more together, even on the touched object. This was fitted to
simulated touches of parts, which were left out of libraries of 3 to 300 parts. The touches were clean or mildly noisy.
"""

from dataclasses import dataclass

import numpy as np

from tactile_loc.core.geometry.rigid import Floats, Ints
from tactile_loc.core.runtime.errors import ConfigError

MOST_BETRAYED = 50.0  # largest exponent


@dataclass(frozen=True)
class NullEvidence:
    """How the misfits of objects, nats, become probabilities of the objects and of "none of these".

    An object becomes e times as probable as another one if its misfit decreases by `temperature`. The *excess* is the
    misfit of the best object beyond the floors of the touches, of which each counts at most `noise`. A floor is the
    misfit that a touch keeps even if it is explained separately, because of its noise. As noise also causes an excess,
    this is divided by 1 + `growth` times the floors.

    Before any touch, an object is unknown with the probability `prior`. An unknown object is mostly betrayed by an
    excess above `gap`; this limit is blurred by `blur`. But the share `chance` of unknown objects is not betrayed by
    one touch, and the share `again` of them is not by each further touch. The share `missed` of known objects has such
    an excess as well, because the search misses them. Nats are positive, and `growth` is not negative;
    shares and `prior` lie between 0 and 1. Otherwise, ConfigError is raised.
    """

    prior: float = 0.2
    gap: float = 1.6
    growth: float = 0.1
    blur: float = 0.45
    noise: float = 8.0
    chance: float = 0.88
    again: float = 0.2
    missed: float = 0.02
    temperature: float = 0.82

    def __post_init__(self) -> None:
        shares = (self.prior, self.chance, self.again, self.missed)
        positive = min(self.gap, self.blur, self.noise, self.temperature) > 0 and self.growth >= 0
        if not (positive and min(shares) > 0 and max(shares) < 1):
            raise ConfigError(
                f"{self} cannot weigh objects; give nats above 0, growth >= 0, and shares between 0 and 1"
            )

    def measure_excess(self, misfits: Floats, floors: Floats) -> float:
        """Return the excess, nats, of the best of K objects with `misfits` (K,) over the `floors` (N,) of N touches.

        It is divided because of noise: see `growth`.
        """
        noise = float(np.minimum(floors, self.noise).sum())
        return max(0.0, float(misfits.min()) - noise) / (1 + self.growth * noise)

    def compute_none(self, excess: Floats | float, touches: Ints | int) -> Floats:
        """Return the probabilities (...) of "none of these" for excesses (...), nats, after `touches` (...) touches."""
        by_chance = self.chance * self.again ** (np.asarray(touches) - 1.0)
        betrayed = np.exp(np.minimum((np.asarray(excess) - self.gap) / self.blur, MOST_BETRAYED))
        ratio = (by_chance + (1 - by_chance) * betrayed) / (1 - self.missed + self.missed * betrayed)
        return np.asarray(self.prior * ratio / (self.prior * ratio + 1 - self.prior))

    def probabilities(self, misfits: Floats, floors: Floats) -> tuple[Floats, float]:
        """Return the probabilities (K,) of K objects, and the probability of "none of these".

        `misfits` (K,) are the objects' misfits, and `floors` (N,) those of the touches, nats. An infinite misfit gives
        probability 0.
        """
        if np.isinf(misfits).all():
            return np.zeros(len(misfits)), 1.0
        none = float(self.compute_none(self.measure_excess(misfits, floors), len(floors)))
        return (1 - none) * share_probability(misfits, self.temperature), none


def share_probability(misfits: Floats, temperature: float) -> Floats:
    """Return the shares (K,) of objects with `misfits` (K,), nats, of the probability of all objects."""
    weights = np.exp(-(misfits - misfits.min()) / temperature)
    return np.asarray(weights / weights.sum())
