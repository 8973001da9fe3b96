"""The report of a sweep: every combination, error against time, what each component does, and what failed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from tactile_loc.io.toml import toml_text
from tactile_loc.reports.documents import guarded
from tactile_loc.reports.markup import choice, details, escape, figure, preformatted, table, tiles, versions_table
from tactile_loc.reports.page import Page, Section
from tactile_loc.reports.source import Source
from tactile_loc.reports.sweep_rows import MEDIAN, Row, components, is_factor, measured_lines, read_rows, varying

TABLE_LINES = ("best-1", "reg-1", "chosen", "closest")
OTHERS = ("coverage_80", "nll_nats", "total_ms", "model_s", "grid_poses")
TIMES = {"total_ms": "time a touch, one pose refined (ms)", "encode_ms": "encode (ms)", "match_ms": "match (ms)",
         "refine_ms": "refine (ms)", "model_s": "building the model (s)"}  # fmt: skip
UNITS = {"_mm": "mm", "_ms": "ms", "_s": "s", "_nats": "nats", "_share": "share"}


def sweep_page(source: Source) -> Page:
    """Return the page of a sweep. Raises ResultError when its files cannot be used."""
    document = source.document()
    return guarded(source, lambda: _page(source, document, read_rows(source)))


def _page(source: Source, document: Mapping[str, Any], rows: list[Row]) -> Page:
    factors, lines = varying(rows), measured_lines(rows)
    failed = [row for row in rows if row.get("error")]
    good = [row for row in rows if not row.get("error")]
    kinds = components(rows) if lines else []
    shown = factors or [factor for factor in ("object", "encoder", "refiner") if factor in rows[0]]
    sections = [
        Section("summary", "", tiles(_tiles(rows, failed, factors, lines)) + _choices(len(good), lines)),
        Section("time", "Error against time", _scatter(rows, factors, lines)),
        Section("effects", "What each component does", _effects(kinds)),
        Section("rows", "Combinations", _table(good, shown, lines)),
        Section("failed", "What failed", _failed(failed, shown) if failed else ""),
        Section("made", "Made with", _made(document, rows, factors)),
    ]
    columns = [*shown, *(f"{line}{MEDIAN}" for line in lines), *(c for c in (*TIMES, *OTHERS) if c in rows[0])]
    columns = list(dict.fromkeys(columns))
    data = {
        "factors": shown, "components": kinds,
        "rows": [{column: row.get(column) for column in columns} for row in good],
    }  # fmt: skip
    title = f"Sweep: {len(rows)} combinations"
    kept = [section for section in sections if section.body]
    return Page(title, _about(document, rows), kept, data, ["errors.js", "sweep.js"])


def _about(document: Mapping[str, Any], rows: Sequence[Row]) -> str:
    objects = list(dict.fromkeys(str(row.get("object")) for row in rows))
    touches = {str(row.get("count")) for row in rows} - {"None"}
    count = f"{touches.pop()} simulated touches a combination; " if len(touches) == 1 else ""
    noises = ", ".join(dict.fromkeys(str(row.get("noise")) for row in rows if row.get("noise")))
    noise = f"noise {noises}; " if noises else ""
    return f"objects {', '.join(objects)}; {count}{noise}{document.get('created', '')}"


def _tiles(
    rows: Sequence[Row], failed: Sequence[Row], factors: Sequence[str], lines: Sequence[str]
) -> Iterable[tuple[str, str, str]]:
    yield "combinations", str(len(rows)), f"that differ in {', '.join(factors) or 'nothing'}"
    yield "failed", str(len(failed)), "combinations that ended with an error"
    if not lines:
        return
    column = lines[0] + MEDIAN
    for name in list(dict.fromkeys(row["object"] for row in rows))[:4]:
        known = [row for row in rows if row["object"] == name and isinstance(row[column], float)]
        if known:
            best = min(known, key=lambda row: float(row[column]))
            made = ", ".join(str(best[f]) for f in factors if f != "object" and best[f])
            yield f"best of {name}", f"{best[column]:.3g} mm", f"median of {lines[0]}: {made}"


def _choices(count: int, lines: Sequence[str]) -> str:
    line = choice("line", "error of", lines, lines[0]) if lines else ""
    return (
        '<p class="choices"><label class="choice">show only <input type="search" id="filter" size="34" '
        f'placeholder="words, as: pin icp"></label>{line}<span class="note" id="count" aria-live="polite">'
        f"{count} combinations</span></p>"
        '<p class="note">What is chosen here holds for the plots and the table below.</p>'
    )


def _scatter(rows: Sequence[Row], factors: Sequence[str], lines: Sequence[str]) -> str:
    times = {k: v for k, v in TIMES.items() if k in rows[0]}
    if not lines or not times:
        return ""
    colours = factors or ["object"]
    first = "refiner" if "refiner" in colours else colours[0]
    choices = choice("time", "against", times) + choice("colour", "coloured by", colours, first)
    caption = "Each dot is a combination; both axes are logarithmic. Hover to see what it is. Lower left is better."
    return f'<div class="choices">{choices}</div>' + figure("scatter", caption, size="tall3d")


def _effects(kinds: Sequence[str]) -> str:
    plots = "".join(
        figure(f"effect-{number}", f"{factor}: error as a multiple of the geometric mean over its values, all else the "
               "same; below 1 is better.", size="middle")
        for number, factor in enumerate(kinds)
    )  # fmt: skip
    return f'<div class="three">{plots}</div>' if plots else ""


def _table(rows: Sequence[Row], factors: Sequence[str], lines: Sequence[str]) -> str:
    if not rows:
        return "<p>No combination ended well.</p>"
    columns = [*factors, *(line + MEDIAN for line in TABLE_LINES if line in lines)]
    columns += [column for column in OTHERS if column in rows[0]]
    head = "".join(
        f'<th scope="col" class="{"sortable left" if is_factor(c) else "sortable"}">{escape(_heading(c))}</th>'
        for c in columns
    )
    body = "".join(
        f'<tr data-row="{number}">' + "".join(_cell(column, row.get(column)) for column in columns) + "</tr>"
        for number, row in enumerate(rows)
    )
    return (
        '<p class="note">Lengths are medians. Click on a heading to sort.</p><div class="tall"><table id="table" '
        f'aria-label="combinations"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
    )


def _cell(column: str, value: Any) -> str:
    if is_factor(column):
        return f'<td class="left">{escape("" if value is None else value)}</td>'
    if not isinstance(value, float):
        return f"<td>{escape('' if value is None else value)}</td>"
    return f'<td data-value="{value!r}">{value:.4g}</td>'


def _heading(column: str) -> str:
    """A column's name; a measure's with its unit in brackets."""
    if is_factor(column):
        return column
    name = column.replace("_median", "")
    for suffix, unit in UNITS.items():
        if name.endswith(suffix):
            return f"{name.removesuffix(suffix).replace('_', ' ')} ({unit})"
    return name.replace("_", " ")


def _failed(rows: Sequence[Row], factors: Sequence[str]) -> str:
    return table([*factors, "error"], [[*(row[f] for f in factors), row["error"]] for row in rows],
                 left=len(factors) + 1, label="what failed")  # fmt: skip


def _made(document: Mapping[str, Any], rows: Sequence[Row], factors: Sequence[str]) -> str:
    same = [(c, str(rows[0][c])) for c in rows[0] if is_factor(c) and c not in factors and rows[0][c] is not None]
    parts = ["<h3>the same in all combinations</h3>", table(["setting", "value"], same, left=2, label="settings")]
    built = document.get("built")
    if isinstance(built, Mapping):
        stages = [(stage, count) for stage, count in built.items() if isinstance(count, int)]
        parts += ["<h3>stages that were built</h3>", table(["stage", "times"], stages, label="stages built")]
    plan = document.get("plan")
    if isinstance(plan, Mapping):
        parts.append(details("plan", preformatted(toml_text(plan))))
    versions = document.get("versions")
    if isinstance(versions, Mapping):
        parts.append(details("versions", versions_table(versions)))
    return "".join(parts)
