"""Base class for all components: options, capabilities, and a description for the store."""

from abc import ABC
from dataclasses import dataclass
from typing import Any, ClassVar

from tactile_loc.core.runtime.options import ComponentOptions
from tactile_loc.slots.code import hash_component


@dataclass(frozen=True)
class Capabilities:
    """Abilities and limits of a component, for the code that uses it.

    - `deterministic`: the same input gives the same output.
    - `exact_undercuts`: the renderer sees surfaces below overhangs.
    - `follows_press_depth`: the encoder's bank must be encoded at the touch's own press depth.
    - `top_k_only`: the matcher scores only some poses, and gives -inf to the others.
    - `weights`: the matcher takes weights of queries.
    - `needs_training`: the encoder must be trained with `fit`.
    - `temperature`: the temperature and the tail that turn the encoder's scores into probabilities (see
      `TemperatureScaling`); if None, they are fitted to each object.
    - `refines`: the refiner moves poses.
    - `covariances`: the refiner estimates covariances.
    - `contact_only`: the fuser uses only which poses touch a sensor, not their probabilities.
    - `places`: the grid lists the object's places instead of poses.
    """

    deterministic: bool = True
    exact_undercuts: bool = True
    follows_press_depth: bool = False
    top_k_only: bool = False
    weights: bool = True
    needs_training: bool = False
    temperature: tuple[float, float] | None = None
    refines: bool = True
    contact_only: bool = False
    places: bool = False
    covariances: bool = False


class Component(ABC):
    """Base class for all components.

    Several threads may call a component at once.

    A hash of the component's code is part of the store's keys, so a changed component gets new results.
    """

    slot: ClassVar[str]
    capabilities: ClassVar[Capabilities] = Capabilities()

    class Options(ComponentOptions):
        """No options."""

    def __init__(self, options: ComponentOptions | None = None) -> None:
        self.options: Any = options if options is not None else self.Options()

    def describe(self) -> dict[str, Any]:
        """Return the class, a hash of its code, and the options, as JSON values: they identify this component's output.

        Neutral options are left out: they change how the component computes, but not its output.
        """
        kind = f"{type(self).__module__}:{type(self).__qualname__}"
        options = self.options.model_dump(mode="json", exclude=self.options.neutral())
        return {"class": kind, "code": hash_component(type(self)), "options": options}
