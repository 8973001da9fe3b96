#!/usr/bin/env python3
"""Draw the pictures of benchmarks.md: accuracy, speed and reliability, from the kept results of the benchmarks.

Each picture is written for light and for dark pages. It keeps the values that it shows, so a test can compare them.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PIL import Image
from PIL.PngImagePlugin import PngInfo

sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))

import quotes
from results import NUMBER, Results, read_latest

from tactile_loc.view.palette import DARK, LIGHT, Palette
from tactile_loc.view.pictures import make_figure, save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

IMAGES = Path(__file__).parent / "images"
OBJECTS = "pin", "hook"
ALL = "all 14"  # row of all parts
NEAR = "within 0.5 mm"  # column of located cases
SIZE = 8.4, 3.9  # inches
KEY = "values"  # of the text in a picture
BLUE, GREEN, ORANGE, PURPLE = "#3f78b8", "#0a9775", "#d9680c", "#b8578a"

Values = dict[str, list[list[float]]]


def read_accuracy(r: Results) -> Values:
    """Return for each kind of touches rows of a number of touches and the share located within 0.5 mm, %."""
    clean, noisy, moved = r["contacts-clean"].table(2), r["contacts-strong"].table(2), r["contacts-misplaced"].table(1)
    counts = r["contacts-clean"].table(1)
    solvable = [[float(n), *_share(counts.numbers(n, ALL))] for n in counts.columns[1:]]
    places = [k for k, name in enumerate(moved.columns) if name.endswith(": within 0.5 mm")]
    (row,) = [row for row in moved.rows if row[0] == ALL]
    return {
        "clean touches, determined cases": solvable,
        "clean touches, all cases": _list_shares(clean.rows, clean.find_column(NEAR)),
        "sensor poses off by 0.5 mm and 0.5°, all cases": [
            [float(moved.columns[place].partition(":")[0]), float(NUMBER.findall(row[place])[0])] for place in places
        ],
        "strong noise, all cases": _list_shares(noisy.rows, noisy.find_column(NEAR)),
    }


def _share(cell: list[float]) -> list[float]:
    """Return the share, %, of a cell such as 80% (112 of 115)."""
    return [round(100 * cell[1] / cell[2], 1)]


def _list_shares(rows: list[list[str]], place: int) -> list[list[float]]:
    return [[float(row[1]), float(NUMBER.findall(row[place])[0])] for row in rows if row[0] == ALL]


def read_speed(r: Results) -> Values:
    """Return for each step the least and the greatest median time, seconds, over the objects."""

    def read_ms(values: quotes.Values) -> list[list[float]]:
        return [[1e-3 * one for one in quotes.ends(values(r))]]

    build = quotes.ends(r.column("startup", 2, "build places, s"))
    first = [r.at("startup", 1, "median, s", f"first `tactile-loc run` of the {name}, compiled")[0] for name in OBJECTS]
    return {
        "one touch of a stated face, one pose refined": read_ms(quotes.times_of("one face, one refined pose")),
        "one touch, any direction, ten poses refined": read_ms(quotes.times_of("whole object, ten refined hypotheses")),
        "three touches together": read_ms(quotes.times_together("3")),
        "five touches together": read_ms(quotes.times_together("5")),
        "build the model of the pin or the hook, once": [build],
        "their first run with three touches, code compiled": [quotes.ends(first)],
    }


def read_reliability(r: Results) -> Values:
    """Return rows of the stated and the measured share, its interval, all in %, and the number of results."""
    table = r["verdicts"].table(3)
    rows = [[float(one) for cell in row[1:] for one in NUMBER.findall(cell)] for row in table.rows if row[0] == "all"]
    wrong = r.at("verdicts", 1, "wrong of these", "all")
    return {"rows": rows, "certain": [wrong[:2]]}


def draw_accuracy(values: Values) -> Figure:
    """Draw the share of located cases against the number of touches."""
    figure = make_figure(*SIZE, constrained=True)
    axes = figure.subplots()
    for (name, rows), colour, mark in zip(values.items(), (GREEN, BLUE, PURPLE, ORANGE), "osD^", strict=True):
        x, y = zip(*rows, strict=True)
        axes.plot(x, y, color=colour, marker=mark, lw=2.2, ms=7, label=name)
        _write_beside(axes, f"{y[-1]:.0f} %", (x[-1], y[-1]), colour)
    axes.set(xlabel="number of touches", ylabel="located within 0.5 mm (%)", ylim=(0, 104), xlim=(0.8, 5.5))
    axes.set_xticks([1, 2, 3, 5])
    _style(axes)
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=9.5)
    return figure


def draw_speed(values: Values) -> Figure:
    """Draw the range of each step's time on a logarithmic scale."""
    figure = make_figure(*SIZE, constrained=True)
    axes = figure.subplots()
    for number, (_, ((low, high),)) in enumerate(values.items()):
        axes.barh(number, high - low, left=low, height=0.5, color=BLUE if number < 4 else ORANGE)
        _write_beside(axes, write_range(low, high), (high, number), LIGHT.ink)
    axes.set(xscale="log", xlim=(2e-3, 60), ylim=(len(values) - 0.4, -0.6), xlabel="time on two CPU cores")
    axes.set_xticks([1e-2, 1e-1, 1, 10], ["10 ms", "100 ms", "1 s", "10 s"])
    axes.set_yticks(range(len(values)), list(values))
    axes.minorticks_off()
    _style(axes, "x")
    return figure


def write_range(low_s: float, high_s: float) -> str:
    """Return a range of times, such as "30 to 46 ms"."""
    if high_s < 1:
        return f"{1e3 * low_s:.0f} to {1e3 * high_s:.0f} ms"
    return f"{low_s:.1f} to {high_s:.1f} s"


def draw_reliability(values: Values) -> Figure:
    """Draw how often first poses are right, against the stated probability, with 95 % intervals."""
    figure = make_figure(*SIZE, constrained=True)
    axes = figure.subplots()
    axes.plot([0, 100], [0, 100], color=LIGHT.soft, lw=1.2, ls=(0, (5, 3)), label="ideal")
    stated, right, low, high, count = zip(*values["rows"], strict=True)
    axes.vlines(stated, low, high, color=BLUE, lw=2)
    sizes = [25 + 0.2 * one for one in count]
    axes.scatter(stated, right, s=sizes, color=BLUE, zorder=3, label="measured; 95 % interval")
    ((wrong, certain),) = values["certain"]
    text = f"certain: {certain:.0f} answers,\n{wrong:.0f} of them wrong"
    axes.annotate(text, (98.6, 99.7), (46, 84), color=GREEN, weight="bold", va="center", ha="center",
                  arrowprops={"arrowstyle": "->", "color": GREEN, "shrinkB": 9})  # fmt: skip
    axes.set(xlabel="stated probability that the first pose is within 1 mm (%)", ylabel="right (%)", xlim=(-2, 103))
    axes.set_ylim(-2, 105)
    _style(axes)
    axes.legend(loc="lower right", frameon=False, fontsize=9.5)
    return figure


def _write_beside(axes: Axes, text: str, place: tuple[float, float], colour: str) -> None:
    from matplotlib.patheffects import withStroke

    halo = [withStroke(linewidth=2.5, foreground=LIGHT.paper)]  # so that grid lines do not cross the text
    axes.annotate(text, place, (9, 0), textcoords="offset points", va="center", color=colour, path_effects=halo)


def _style(axes: Axes, axis: Any = "y") -> None:
    axes.grid(axis=axis, color=LIGHT.line, lw=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


PICTURES = {
    "accuracy": (read_accuracy, draw_accuracy),
    "speed": (read_speed, draw_speed),
    "reliability": (read_reliability, draw_reliability),
}


def find_picture(name: str, palette: Palette) -> Path:
    """Return the path of a picture in a palette."""
    return IMAGES / f"quality-{name}{'-dark' if palette is DARK else ''}.png"


def repaint(figure: Figure, palette: Palette) -> Figure:
    """Give a figure on light paper the paper, the text and the lines of a palette, and return it."""
    from matplotlib.colors import to_hex
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch
    from matplotlib.patheffects import withStroke
    from matplotlib.text import Text

    new = {getattr(LIGHT, name): getattr(palette, name) for name in ("paper", "ink", "soft", "line")}
    new["#000000"] = palette.ink
    parts: list[Any] = figure.findobj(lambda one: isinstance(one, Text | Line2D))
    for part in parts:
        part.set_color(new.get(to_hex(part.get_color()), part.get_color()))
        if part.get_path_effects():
            part.set_path_effects([withStroke(linewidth=2.5, foreground=palette.paper)])
    patches: list[Any] = figure.findobj(Patch)
    for patch in patches:
        for get, put in ((patch.get_facecolor, patch.set_facecolor), (patch.get_edgecolor, patch.set_edgecolor)):
            put(new.get(to_hex(get()), get()) if get()[3] else get())
    return figure


def read_values(path: Path) -> Values:
    """Return the values that a picture shows."""
    with Image.open(path) as picture:
        values: Values = json.loads(picture.text[KEY])
    return values


def main() -> None:
    """Draw all pictures."""
    results = read_latest()
    for name, (read, draw) in PICTURES.items():
        values, info = read(results), PngInfo()
        info.add_text(KEY, json.dumps(values))
        for palette in (LIGHT, DARK):
            path = save_figure(find_picture(name, palette), repaint(draw(values), palette))
            with Image.open(path) as picture:
                picture.convert("RGB").quantize(128).save(path, pnginfo=info, optimize=True)
            print(path)


if __name__ == "__main__":
    main()
