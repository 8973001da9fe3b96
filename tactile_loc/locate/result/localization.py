"""The result of a localisation."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tactile_loc.core.geometry.pose_words import describe_first
from tactile_loc.core.geometry.rigid import Floats
from tactile_loc.core.objects.mesh import ObjectModel
from tactile_loc.core.poses.pose_errors import measure_pose_errors
from tactile_loc.core.poses.posterior import PosePosterior
from tactile_loc.core.poses.priors import Prior
from tactile_loc.core.poses.tolerance import ONE_MILLIMETRE, Tolerance
from tactile_loc.core.runtime.errors import ConfigError, ResultError, TactileLocError
from tactile_loc.core.runtime.formatting import format_percent
from tactile_loc.core.sensing.scene import Scene, View, view_touch
from tactile_loc.core.sensing.touch import Touch
from tactile_loc.io.config import RunConfig
from tactile_loc.io.json_keys import write_keys
from tactile_loc.io.options import CERTAIN
from tactile_loc.locate.probability.conformal import PoseSet
from tactile_loc.locate.probability.evidence import Evidence, Question, gather_evidence
from tactile_loc.locate.probability.outcome_model import load_outcome_model
from tactile_loc.locate.result import result_arrays, result_json
from tactile_loc.locate.result.assessment import Assessment, Origin, PoseErrors
from tactile_loc.locate.result.freedom import Freedom, explain_as_well, find_as_well, find_freedom
from tactile_loc.locate.result.hypothesis import Agreement as Agreement
from tactile_loc.locate.result.hypothesis import Hypothesis as Hypothesis
from tactile_loc.locate.result.hypothesis import RefinedBy as RefinedBy
from tactile_loc.locate.result.result_html import write_html
from tactile_loc.locate.result.verdict import (
    STATES_PROBABILITY,
    Outcome,
    Verdict,
    describe_within,
    explain_verdict,
    judge,
    name_next_step,
)
from tactile_loc.slots.registry import registry
from tactile_loc.store.files import lock_folder, write_json

QUANTILES_M = (3e-4, 5e-4, 1e-3, 2e-3, 3e-3)  # tolerances to which the model of outcomes was fitted
EXPLAINED = -0.5  # excess of a touch that four in five right poses do not exceed
LEAST_BETTER = 0.1  # gain of imprint IoU without a prior by which the prior contradicts the touches
LEAST_AGREEING = 3  # two of three touches may agree by chance, if sensor poses are wrong


@dataclass(frozen=True, eq=False)
class Localization:
    """The result: the posterior, its distinct hypotheses, the best first, and the seconds of each stage.

    Poses are in the sensor frame of the first touch, `touch`; `others` are the other touches. If a coverage was
    requested, the hypotheses are a set that contains the true pose with this probability, and `pose_set` describes it.

    The posterior includes outliers (see `agreement`), but the hypotheses do not. Touches that were `left_out` because
    they contradict the others affect neither the posterior nor the hypotheses.

    `config` is the configuration of the localizer; None if a localisation was made by hand. `unlisted` are refined
    hypotheses after the listed ones. They count for the verdict, but files do not keep them. `unexpected` states
    whether the `prior`, over poses in the first sensor's frame, makes the first pose very improbable. The `outcome`
    has the probability that the first pose is right, computed from the `evidence`; both are None if a localisation
    was made by hand. `refined_by` states what refined the poses; None if it is unknown. `assessed` and `origin` are
    those of a file; None if they are not known yet.
    """

    touch: Touch
    posterior: PosePosterior
    hypotheses: tuple[Hypothesis, ...]
    seconds: dict[str, float]
    others: tuple[Touch, ...] = ()
    pose_set: PoseSet | None = None
    agreement: Agreement = field(default_factory=Agreement)
    left_out: tuple[Touch, ...] = ()
    config: RunConfig | None = None
    unlisted: tuple[Hypothesis, ...] = ()
    unexpected: bool = False
    prior: Prior | None = None
    evidence: Evidence | None = None
    outcome: Outcome | None = None
    refined_by: RefinedBy | None = None
    assessed: Assessment | None = None
    origin: Origin | None = None

    def save(self, folder: str | Path, locked: bool = False) -> list[Path]:
        """Write `result.json` and `result.npz`, the files of `tactile-loc run`, and return their paths.

        Each file is written atomically. The folder is locked meanwhile, unless it is `locked` by the caller. Raises
        OutputError when writing fails, and ResultError if `config` is unknown.
        """
        folder, document = Path(folder), self.to_json()
        with nullcontext() if locked else lock_folder(folder):
            return [
                write_json(folder / result_json.NAME, document),
                result_arrays.write_arrays(folder / result_arrays.NAME, self._pack_arrays(), document),
            ]

    @classmethod
    def load(cls, path: str | Path) -> Localization:
        """Read a localisation that `save` or `tactile-loc run` wrote; `path` is the folder or its result.json.

        Poses of the posterior and the surface are rounded to float32. The posterior has at most the 20 000 most
        probable poses, and a surface of more than 50 000 triangles is decimated. Raises ResultError if the files cannot
        be used, and ConfigError if this version lacks one of the settings.
        """
        path = Path(path)
        path = path / result_json.NAME if path.is_dir() else path
        document = result_json.read_result(path)
        arrays = result_arrays.read_arrays(path.with_name(result_arrays.NAME), document)
        try:
            config = RunConfig.from_dict(document["configuration"], str(path))
        except ConfigError as error:
            raise ConfigError(f"{error}; {result_json.AGAIN}") from error
        try:
            return cls._of_files(document, arrays, config)
        except (KeyError, TypeError, ValueError, TactileLocError) as error:
            raise ResultError(f"{path} or the .npz file beside it is damaged: {error}; {result_json.AGAIN}") from error

    @classmethod
    def _of_files(cls, document: dict[str, Any], arrays: result_arrays.Arrays, config: RunConfig) -> Localization:
        """Make a localisation of the document and the arrays of its files. Raises ValueError and others for damage."""
        documents = [document["touch"], *document["other_touches"]]
        obj = result_json.read_object(document["object"], result_arrays.unpack_mesh(arrays))
        posterior = result_arrays.unpack_posterior(arrays, obj, document["posterior_touches"], document["elsewhere"])
        touch, *others = result_arrays.unpack_touches(arrays, "touch", documents)
        hypotheses = result_json.read_hypotheses(document["hypotheses"], touch.T_base_sensor)
        nearest = posterior.grid.nearest(np.array([h.T_sensor_object_grid for h in hypotheses]))[1]
        return cls(
            touch,
            posterior,
            tuple(replace(h, grid_index=int(index)) for h, index in zip(hypotheses, nearest, strict=True)),
            document["seconds"],
            tuple(others),
            result_json.read_pose_set(document["pose_set"]),
            result_json.read_agreement(documents, document["contradictory"]),
            result_arrays.unpack_touches(arrays, "left_out", document["left_out"]),
            config,
            unexpected=document["unexpected"],
            outcome=result_json.read_outcome(document),
            refined_by=result_json.read_refined_by(document["refined_by"]),
            assessed=result_json.read_assessment(document, float(np.exp(arrays["log_p"]).sum())),
            origin=Origin(**{name: document[name] for name in Origin.__dataclass_fields__}),
        )

    def reduce(self) -> Localization:
        """Return the result as its files keep it (see `load`). Raises ResultError if `config` is unknown."""
        return self._of_files(self.to_json(), self._pack_arrays(), self._require_config())

    def _pack_arrays(self) -> result_arrays.Arrays:
        return result_arrays.pack_arrays(self.posterior, self.touches, self.left_out)

    def to_json(self) -> dict[str, Any]:
        """Return the document of `result.json`, as JSON values. Raises ResultError if `config` is unknown."""
        source, agreement, about = self._require_config().touch, self.agreement, self.assessment
        best_ious = agreement.best_ious or (None,) * len(self.touches)
        errors_m = (None,) * len(self.hypotheses) if about.errors is None else about.errors.of_hypotheses_m
        touch, *others = (
            result_json.write_touch(one, source, best, number in agreement.outliers)
            for number, (one, best) in enumerate(zip(self.touches, best_ious, strict=True))
        )
        pairs = zip(self.hypotheses, errors_m, strict=True)
        return write_keys(
            result_json.RESULT,
            about,
            probability_within=None if about.outcome is None else about.outcome.right,
            schema_version=result_json.SCHEMA_VERSION,
            **vars(self.made_with),
            object=result_json.write_object(self.object),
            touch=touch,
            other_touches=others,
            contradictory=agreement.contradictory,
            left_out=[result_json.write_touch(one, source) for one in self.left_out],
            tolerance=self.tolerance,
            unexpected=self.unexpected,
            freedom=about.freedom.to_json(),
            elsewhere=self.posterior.elsewhere,
            missed=self.posterior.elsewhere if self.outcome is None else self.outcome.missed,
            posterior_touches=self.posterior.touches,
            refined_by=None if self.refined_by is None else write_keys(result_json.REFINED_BY, self.refined_by),
            hypotheses=[result_json.write_hypothesis(rank, *pair) for rank, pair in enumerate(pairs, 1)],
            pose_set=None if self.pose_set is None else write_keys(result_json.POSE_SET, self.pose_set),
            errors=None if about.errors is None else write_keys(result_json.ERRORS, about.errors),
            seconds=self.seconds,
        )

    @cached_property
    def made_with(self) -> Origin:
        """The time, versions and settings of the result. Raises ResultError if `config` is unknown."""
        return self.origin or Origin.of(self._require_config())

    @cached_property
    def assessment(self) -> Assessment:
        """The assessment of the first pose, from all scored poses."""
        if self.assessed is not None:
            return self.assessed
        errors_m, errors = self.measure_errors_m(self.object), None
        if errors_m is not None:
            T_true = np.asarray(self.touch.T_sensor_object)
            nearest = self.posterior.grid.nearest(T_true[None])[1]
            closest_m = measure_pose_errors(self.object, self.posterior.grid.T_sensor_object[nearest], T_true)[0]
            errors = PoseErrors(tuple(errors_m.tolist()), float(closest_m))
        kept = result_arrays.find_most_probable(self.posterior)
        return Assessment(
            self.verdict,
            self.outcome,
            self.freedom,
            name_next_step(self.verdict, len(self.touches)),
            len(self.posterior.grid),
            self.posterior.entropy,
            float(np.exp(self.posterior.log_p[kept]).sum()),
            errors,
            self.poor_touches,
            self.find_error_quantile_m(),
        )

    @property
    def object(self) -> ObjectModel:
        """The located object."""
        return self.posterior.grid.metric.object

    def make_views(self) -> list[View]:
        """Return the touches' views, with scenes that draw the object as the localizer did.

        Raises ResultError if `config` is unknown.
        """
        config = self._require_config()
        renderer = registry().create("renderer", config.renderer.name, config.renderer.options)
        scenes = (Scene(self.object, touch.geometry, renderer) for touch in self.touches)
        return [view_touch(self.touch, touch, scene) for touch, scene in zip(self.touches, scenes, strict=True)]

    def _require_config(self) -> RunConfig:
        if self.config is None:
            raise ResultError("the localisation does not know its configuration; make it with Localizer.localize")
        return self.config

    @property
    def tolerance(self) -> Tolerance:
        """The largest error of a pose that the verdict counts as right: that of `config`, or else 1 mm."""
        return ONE_MILLIMETRE if self.config is None else self.config.tolerance

    @property
    def touches(self) -> tuple[Touch, ...]:
        """The touches that were localised together."""
        return (self.touch, *self.others)

    @property
    def outliers(self) -> tuple[Touch, ...]:
        """The touches that contradict all others, while the others agree."""
        return tuple(self.touches[number] for number in self.agreement.outliers)

    @property
    def best(self) -> Hypothesis:
        """The most probable hypothesis."""
        return self.hypotheses[0]

    @property
    def T_base_object(self) -> Floats | None:  # noqa: N802 - the transform's name
        """The most probable pose (4, 4), metres, in the frame of the sensors' poses; None if these are unknown."""
        return self.best.T_base_object

    @cached_property
    def verdict(self) -> Verdict:
        """How far the first hypothesis can be trusted, in one word.

        It is certain if the outcome's probability that the first pose is within `tolerance` of the true pose is at
        least `confidence`. It is never certain if a touch has no depths, if the pose has no covariance, or if the prior
        makes it very improbable. The verdict is "poor fit" if the pose explains a touch worse than right poses do, or
        if touches contradict each other, unless at least LEAST_AGREEING of them agree. If probably none of the poses is
        right, it is "not found", or "ambiguous" if the first one explains the touches well and what they leave open is
        known.
        """
        if self.assessed is not None:
            return self.assessed.verdict
        if self._is_contradicted:
            return Verdict.POOR_FIT
        verdict = judge(self.outcome, sure=self.is_sure, poor=bool(self.poor_touches), least=self.confidence)
        if verdict is Verdict.NOT_FOUND and self.outcome and self.evidence and str(self.freedom):
            explained = load_outcome_model().measure_excess(self.evidence).max() <= EXPLAINED
            return Verdict.AMBIGUOUS if explained else verdict
        return verdict

    @property
    def is_sure(self) -> bool:
        """Whether the first pose may be certain: see `verdict`."""
        return self.depths_known and not self.unexpected and self.best.covariance is not None

    @property
    def confidence(self) -> float:
        """The probability, 0 to 1, from which the first pose is certain: that of `config`, or else CERTAIN."""
        return CERTAIN if self.config is None else self.config.confidence

    @cached_property
    def poor_touches(self) -> tuple[int, ...]:
        """The numbers of the touches that the first pose explains worse than right poses do, at the touches' noise.

        A pose that was not refined is not judged, and neither are contact masks. Outliers do not count.
        """
        if self.assessed is not None:
            return self.assessed.poor_touches
        if self.evidence is None or not self.best.is_refined or not self.depths_known:
            return ()
        trusted = [number for number in range(len(self.touches)) if number not in self.agreement.outliers]
        excess = load_outcome_model().measure_excess(self.evidence)
        return tuple(number for number, more in zip(trusted, excess, strict=True) if more > 0)

    def compare_without_prior(self, alone: Localization) -> Localization:
        """Return this result of a prior, `unexpected` if the touches `alone`, without it, are explained far better."""
        same = (len(alone.touches), alone.agreement.outliers) == (len(self.touches), self.agreement.outliers)
        better = same and alone.best.imprint_iou > self.best.imprint_iou + LEAST_BETTER
        return replace(self, unexpected=self.unexpected or better)

    @property
    def depths_known(self) -> bool:
        """Whether all touches have depths; a contact mask has none."""
        return all(touch.has_depths for touch in self.touches)

    @property
    def _is_contradicted(self) -> bool:
        if self.agreement.contradictory and not self.agreement.outliers:
            return True
        wrong = len(self.outliers) + len(self.left_out)
        return wrong > 0 and len(self.touches) - len(self.outliers) < LEAST_AGREEING

    def probability_within(self, tolerance: Tolerance | str | None = None) -> float:
        """Return the probability, 0 to 1, that the first pose is within a tolerance of the true pose.

        The tolerance is a text such as "0.5mm,2deg", a `Tolerance`, or by default that of the result. Poses that are
        equal by symmetry count as equal. Raises ConfigError if the text cannot be read, and ResultError if `config` is
        unknown, or for another tolerance if the result was read from a file.
        """
        asked = Tolerance.parse(tolerance) if isinstance(tolerance, str) else tolerance or self.tolerance
        if self.outcome is not None and asked == self.tolerance:
            return self.outcome.right
        if self.assessed is not None:
            raise ResultError(f"files keep only the listed poses; locate again with the tolerance {asked}")
        trusted = [view for number, view in enumerate(self.make_views()) if number not in self.agreement.outliers]
        question = Question(self.object, asked, self.prior, self.agreement.contradictory)
        evidence = gather_evidence(trusted, [*self.hypotheses, *self.unlisted], question)
        return load_outcome_model().predict(evidence).right

    def find_error_quantile_m(self) -> float | None:
        """Return the least of QUANTILES_M, metres, that the pose error does not exceed with 95 % probability.

        Returns None if the error may be greater than all of them, or if it is unknown.
        """
        if self.assessed is not None:
            return self.assessed.error_quantile_m
        known = self.outcome is not None and self.config is not None and self.depths_known and not self.unexpected
        if not known or self.verdict not in STATES_PROBABILITY:
            return None
        return next((m for m in QUANTILES_M if self.probability_within(Tolerance(m)) >= CERTAIN), None)

    @property
    def as_well(self) -> float:
        """By how much less imprint IoU a pose can have, 0 to 1, and still explain the touches as well as another."""
        return find_as_well(self.touches)

    @cached_property
    def freedom(self) -> Freedom:
        """What the touches leave open about the first pose: other poses, slides and turns.

        If no probe of the first pose explains the touches as well, no small motion does.
        """
        if self.assessed is not None:
            return self.assessed.freedom
        T = np.stack([h.T_sensor_object for h in self.hypotheses])
        ious = np.array([h.imprint_iou for h in self.hypotheses])
        others = explain_as_well(ious, ious[0], self.as_well) & ~self.tolerance.find_within(self.object, T[0], T)
        is_open = self.evidence is None or bool((self.evidence.probe_losses <= self.as_well).any())
        contact_m = self.touch.geometry.gel_middle_m
        return find_freedom(T, others, self.best.covariance, contact_m, self.object, self.tolerance, is_open=is_open)

    @property
    def equal_explanations(self) -> tuple[Hypothesis, ...]:
        """The hypotheses that explain the touches as well as the one that explains them best, which is one of them."""
        ious = np.array([h.imprint_iou for h in self.hypotheses])
        return tuple(self.hypotheses[k] for k in np.flatnonzero(explain_as_well(ious, ious.max(), self.as_well)))

    def count_explanations(self) -> str:
        """State in words how many of the listed poses explain the touches equally well."""
        count, touched = len(self.equal_explanations), "touches" if self.others else "touch"
        if count == 1:
            return f"one pose explains the {touched} best"
        least = "at least " if count == len(self.hypotheses) else ""
        return f"{least}{count} poses explain the {touched} equally well"

    def summary(self) -> str:
        """Return the result in words: the verdict, the first pose in mm and degrees, and the next step.

        An ambiguous verdict is followed by what is known and what is open.
        """
        best = self.best
        T, frame = best.T_sensor_object, "sensor's"
        if best.T_base_object is not None:
            T, frame = best.T_base_object, "base"
        first = describe_first(T, len(self.hypotheses), frame)
        lines = [f"{self.verdict}: {self.explain()}", first]
        within = self.describe_within()
        lines.append(", ".join(filter(None, (within, f"imprint IoU {format_percent(best.imprint_iou)}"))))
        if step := name_next_step(self.verdict, len(self.touches)):
            lines.append(f"next: {step}")
        return "\n".join(lines)

    def explain(self) -> str:
        """Return the meaning of the verdict; if it is ambiguous, what is known and what is open."""
        return (self.verdict is Verdict.AMBIGUOUS and str(self.freedom)) or explain_verdict(self.verdict)

    def describe_within(self) -> str:
        """State in words how probable it is that the first pose is right; empty if the verdict makes it misleading."""
        right = self.outcome.right if self.outcome is not None and self.depths_known else None
        return describe_within(self.verdict, right, self.tolerance)

    def describe_search(self) -> str:
        """State in words the number of scored poses, and the probability that the object is at none of them."""
        count, elsewhere = self.assessment.grid_poses, self.posterior.elsewhere
        if not elsewhere:
            return f"{count} poses searched"
        return f"{count} likely poses found, {format_percent(elsewhere)} probability that the true pose is elsewhere"

    def __str__(self) -> str:
        return self.summary()

    def _repr_html_(self) -> str:
        """Return the result as HTML, which notebooks display: see `result_html.write_html`."""
        return write_html(
            self.summary(), self.hypotheses, self.touches, [] if self.config is None else self.make_views()
        )

    def measure_errors_m(self, obj: ObjectModel) -> Floats | None:
        """Return each hypothesis's pose error (K,), metres; None if the true pose is unknown."""
        T_true = self.touch.T_sensor_object
        if T_true is None:
            return None
        T = np.stack([h.T_sensor_object for h in self.hypotheses])
        return measure_pose_errors(obj, T, T_true)

    @cached_property
    def normalised_entropy(self) -> float:
        """Entropy of the posterior over N poses divided by log N: 0 if one pose is certain, 1 if all are equal."""
        return self.assessment.normalised_entropy
