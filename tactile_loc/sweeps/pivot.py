"""A sweep as Markdown: combinations of components against objects, for a paper."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from tactile_loc.core.formatting import mm
from tactile_loc.evaluation.tabular import markdown_table
from tactile_loc.sweeps.summary import Cell, cells, fixed
from tactile_loc.sweeps.sweep import Sweep

FAILED = "failed"


def markdown(sweep: Sweep, line: str) -> str:
    """Return a table for each noise: the median ADD of `line`, mm, the best of each object in bold; then the errors."""
    plan = sweep.plan
    seeds = f", the mean over seeds {', '.join(map(str, plan.seeds))}" if len(plan.seeds) > 1 else ""
    parts = [f"# Sweep: {line}\n"]
    parts.append(
        f"Median surface distance (ADD, symmetry regarded) of `{line}` over {plan.count} simulated touches, mm{seeds}; "
        "the best of each column is bold."
    )
    if plan.noises and (same := fixed(plan)):
        parts.append(f"The same everywhere: {', '.join(f'{slot} {one.name}' for slot, one in same.items())}.")
    found = cells(sweep, line)
    for noise in plan.noises:
        parts.append(f"\n## Noise: {noise}\n\n{pivot([cell for cell in found if cell.noise == noise])}")
    parts += _failures(sweep)
    return "\n".join(parts).rstrip() + "\n"


def pivot(found: Sequence[Cell]) -> str:
    """Return the cells of one noise as a Markdown table: a row for each label, a column for each object."""
    objects = list(dict.fromkeys(cell.object for cell in found))
    best = {name: min((c.error_mm for c in found if c.object == name and c.error_mm is not None), default=None)
            for name in objects}  # fmt: skip
    rows: dict[tuple[int, ...], list[str]] = {}
    for cell in found:
        rows.setdefault(cell.choices, [cell.label]).append(_text(cell.error_mm, best[cell.object]))
    return markdown_table(["components", *objects], rows.values())


def _text(error_mm: float | None, best_mm: float | None) -> str:
    if error_mm is None or best_mm is None:
        return FAILED
    text = mm(1e-3 * error_mm)
    return f"**{text}**" if text == mm(1e-3 * best_mm) else text


def _failures(sweep: Sweep) -> Iterator[str]:
    if sweep.failed:
        yield f"\n## Failed: {sweep.failed} of {len(sweep.combinations)}\n"
    for one in sweep.combinations:
        error = sweep.outcomes[one.key].error
        if error:
            names = ", ".join(getattr(one.config, slot).name for slot in sweep.plan.slots)
            yield f"- {one.object}, {names}, noise {one.config.touch.noise}, seed {one.config.seed}: {error}"
