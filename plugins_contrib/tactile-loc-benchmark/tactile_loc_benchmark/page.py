"""The HTML report of a benchmark: tables, plots, and an example touch of each source."""

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from tactile_loc import ExampleSummary, ExampleTable, Page, Section, StageStore, paint_shape
from tactile_loc.commands import encode_png, make_png_url
from tactile_loc.plugin import SensorGeometry

from tactile_loc_benchmark.examples import DrawnTouches, ExampleDrawer
from tactile_loc_benchmark.files import (
    TABLE_NOTE,
    describe_suite,
    tabulate,
    tabulate_failures,
    tabulate_methods,
    tabulate_sources,
)
from tactile_loc_benchmark.job import Row
from tactile_loc_benchmark.prepare import PreparedSource
from tactile_loc_benchmark.results import Results
from tactile_loc_benchmark.runner import Benchmark
from tactile_loc_benchmark.summary import WITHIN_M, group_examples

BEYOND_MM, DIGITS = 1e6, 4  # the error of an example without a pose; digits of errors


def make_benchmark_page(results: Results, pictures: Sequence[Mapping[str, Any]]) -> Page:
    """Return the page of a benchmark with rows. `pictures` is the result of `show_sources`."""
    groups, tables = results.groups, group_examples(results.rows).values()
    suite = results.suite.model_dump(mode="json", exclude_none=True)
    sections = [
        Section("summary", "", {"numbers": list(_list_numbers(results)), **_list_choices(groups)}),
        Section("success", "Success"),
        Section("curves", "Recall"),
        Section("reliability", "Reliability of the probabilities"),
        Section("times", "Time"),
        Section("table_section", "All results", {"rows": tabulate(groups), "note": TABLE_NOTE}),
        Section("sources", "Sources", {"rows": tabulate_sources(results), "examples": pictures}),
        Section("methods", "Methods", {"rows": tabulate_methods(results)}),
        *([Section("failures", "Failures", {"rows": tabulate_failures(results)})] if results.failed else []),
        Section("made", "Settings", {"suite": json.dumps(suite, indent=1), "versions": list(results.versions.items())}),
    ]
    data = {
        "groups": [_collect_group(group, of) for group, of in zip(groups, tables, strict=True)],
        "methods": list(dict.fromkeys(group["method"] for group in groups)),
        "within_mm": [1e3 * m for m in WITHIN_M],
    }
    title = f"Benchmark: {results.suite.name}"
    return Page(
        "benchmark", title, describe_suite(results), sections, data, ["errors.js", "benchmark.js"], package=__package__
    )


def _list_numbers(results: Results) -> Iterator[tuple[str, str, str]]:
    used = [source for source in results.sources if not source.problem]
    objects = {name for source in used for name in source.objects}
    yield "sources", str(len(used)), f"{len(results.sources) - len(used)} left out"
    methods = [method for method in results.methods if not method.problem]
    yield "methods", str(len(methods)), f"{len(results.methods) - len(methods)} left out"
    yield "objects", str(len(objects)), f"{results.suite.examples} examples of each, with each source"
    yield "jobs", str(results.jobs), f"{len(results.failed)} failed"


def _list_choices(groups: Sequence[Row]) -> dict[str, Any]:
    touches = sorted({group["touches"] for group in groups})
    return {
        "sources": list(dict.fromkeys(group["source"] for group in groups)),
        "touches": {n: f"{n} {'touch' if n == 1 else 'touches'}" for n in touches},
        "most": touches[-1],
        "within": {k: f"{1e3 * m:g} mm" for k, m in enumerate(WITHIN_M)},
    }


def _collect_group(group: Row, table: ExampleTable) -> dict[str, Any]:
    """Return the values of a group for the page's scripts, in mm, % and seconds."""
    return {
        **{name: group[name] for name in ("source", "method", "touches", "examples")},
        "within": [100 * share for share in group["within"]],
        "ranges": [[100 * low, 100 * high] for low, high in group["within_range"]],
        "seconds": group["median_s"],
        "errors_mm": {
            line: [float(f"{min(1e3 * error, BEYOND_MM):.{DIGITS}g}") for error in np.sort(table.errors_m(line))]
            for line in ("first", "listed")
        },
        "bins": [
            {"stated": 100 * one.stated, "right": 100 * one.right, "examples": one.examples}
            for one in ExampleSummary.of(table).bins
            if one.stated is not None and one.right is not None
        ],
    }


def show_sources(found: Benchmark, store: StageStore) -> Iterator[Mapping[str, Any]]:
    """Yield a touch of each source, as JSON values with pictures: what the sensor saw, and the shape that it read.

    The touches come from the store.
    """
    for source in found.sources:
        for obj in source.objects.values():
            drawer = ExampleDrawer(found.suite, source.entry, source.table, obj)
            if (examples := drawer.find(store)) is not None and (examples.count > 0).any():
                yield _show_touch(source, obj.name, examples, drawer.sensor.geometry)
                break


def _show_touch(
    source: PreparedSource, name: str, examples: DrawnTouches, geometry: SensorGeometry
) -> Mapping[str, Any]:
    shape = examples.get_shape(int(np.argmax(examples.count > 0)), 0)
    seen = examples.picture
    return {
        "source": source.entry.label,
        "object": name,
        "press": f"{1e3 * shape.press_depth_m:.2f} mm",
        "photo": make_png_url(encode_png(seen)) if seen.ndim == 3 else None,
        "shape": make_png_url(encode_png(paint_shape(shape, geometry))),
    }
