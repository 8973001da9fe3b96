"""The located examples of a benchmark as scenes of the BOP benchmark."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from tactile_loc.evaluation.recall.bop import Answer, BopScene

from tactile_loc_benchmark.job import Row


def make_scenes(rows: Sequence[Row]) -> list[BopScene]:
    """Return a scene for each source and object; poses are in the base frame."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["source"], row["object"]), []).append(row)
    return [
        BopScene(name, {"source": source}, np.array(list(_list_truth(some))), _gather_answers(some))
        for (source, name), some in groups.items()
    ]


def _list_truth(rows: Sequence[Row]) -> Iterator[list[list[float]]]:
    """Yield the true pose of each example, which every located row states; NaN if no method located the example."""
    known = {row["example"]: row["true_T_base_object"] for row in rows if "true_T_base_object" in row}
    for example in range(1 + max(row["example"] for row in rows)):
        yield known.get(example, np.full((4, 4), np.nan).tolist())


def _gather_answers(rows: Sequence[Row]) -> dict[tuple[str, int], list[Answer]]:
    answers: dict[tuple[str, int], list[Answer]] = {}
    for row in rows:  # a job's rows are in the order of the examples
        answer = Answer(row.get("T_base_object", ()), row.get("scores", ()), row.get("seconds", np.nan))
        answers.setdefault((row["method"], row["touches"]), []).append(answer)
    return answers
