"""The sentences of the documentation whose figures are computed from results, by page.

`{}` stands for a figure. The page decides how many decimals it shows. Figures in SETTINGS do not come from a table.
"""

from collections.abc import Callable, Sequence
from itertools import accumulate
from math import hypot
from statistics import geometric_mean, mean, median

from results import Results

from tactile_loc.locate.probability.null_evidence import NullEvidence

Values = Callable[[Results], Sequence[float]]

DRAWN = ("same mesh", "scanned, 0.05 mm", "scanned, 0.1 mm", "decimated, 0.1 mm", "unseen noise")
PARTS_APART = ("pin", "damping_pin", "cotter")
EXAMPLES = 15  # number of examples in each row of the table of outliers
PAPER = (
    ("pin", "best-1", "0.11"), ("damping pin", "best-1", "0.16"), ("head", "best-1", "0.18"),
    ("elbow pipe", "best-1", "0.87"), ("elbow pipe", "best-10", "0.26"), ("elbow pipe", "best-50", "0.08"),
)  # fmt: skip


def ends(values: Sequence[float]) -> list[float]:
    """Return the least and the greatest value."""
    return [min(values), max(values)]


def ratios(above: Sequence[float], below: Sequence[float]) -> list[float]:
    """Return the ratio of each pair of numbers."""
    return [a / b for a, b in zip(above, below, strict=True)]


def beside_the_paper(name: str, line: str) -> Values:
    """Return a function for the normalised medians in a row: those of pixels and of the learned encoder."""
    return lambda r: [r.at("encoders", 1, line, name, encoder)[1] for encoder in ("pixel", "moco")]


def presses(column: str, way: int) -> Values:
    """Return a function for the errors with random (0) or spread (1) presses, divided by the errors with all."""
    return lambda r: ratios(r.column("few_presses", 1, column)[way::2], r.column("few_presses", 1, "all"))


def range_of(run: str, number: int, column: str) -> Values:
    """Return a function for the least and the greatest number of a column."""
    return lambda r: ends(r.column(run, number, column))


def certain_wrong(r: Results) -> list[float]:
    """Return the number of answers that were called certain, and the number of wrong ones among them."""
    wrong, count, *_ = r.at("verdicts", 1, "wrong of these", "all")
    return [count, wrong]


def times_together(touches: str) -> Values:
    """Return a function for the least and the greatest median time of some clean touches with two threads, ms."""
    begin = [touches, "clean", "2"]

    def find(r: Results) -> list[float]:
        table = r["stages"].table(1)
        return ends([float(row[table.find_column("all, ms")]) for row in table.filled if row[1:4] == begin])

    return find


def times_of(step: str) -> Values:
    """Return a function for the times of a step with two threads, ms, of the pin and the hook."""
    return lambda r: [r.at("locate-times", 1, f"{name}, 2 threads, ms", step)[0] for name in ("pin", "hook")]


def five_located(r: Results) -> list[float]:
    """Return shares of located cases, %: of solvable cases with 2, 3 and 5 clean touches, of all cases with 3 and 5."""
    cells = [r.at("contacts-clean", 1, touches, "all 14") for touches in "235"]  # such as 80% (114 of 117)
    return [*(100 * hits / of for _, hits, of in cells), cells[1][0], cells[2][0]]


def outside(r: Results, touches: str, *drawn: str) -> list[float]:
    """Return the mean share over the parts, %, of examples within 1 mm, for touches of each of the meshes `drawn`."""
    return [mean(r.at("outside", 1, "within 1 mm", part, one, touches)[0] for part in PARTS_APART) for one in drawn]


def medians_outside(r: Results, *drawn: str) -> list[float]:
    """Return the least and the greatest median of three touches, mm."""
    return ends([r.at("outside", 1, "median, mm", part, one, "3")[0] for part in PARTS_APART for one in drawn])


def renderer(r: Results, digits: int, place: int) -> list[float]:
    """Return the range of the heightmap renderer's poses per second (place 0), or of its ratio to OpenGL (1)."""
    table, demo = r["renderers-parts"].table(1), r["renderers"].table(1)
    parts = [table.numbers("heightmap", *row[:2])[place] for row in table.rows]
    column = demo.find_column(("poses/s", "x pyrender")[place])
    found = [*parts, *(float(row[column]) for row in demo.rows if "heightmap" in row)]
    return [round(value, digits) for value in ends(found)]


def one_touch(r: Results) -> list[float]:
    """Return the range of the errors, mm, on the seven parts with the smallest errors."""
    return ends(sorted(r.column("single_touch", 1, "chosen"))[:7])


def encoded(r: Results, encoder: str, column: str) -> list[float]:
    """Return a column of an encoder's rows, object by object."""
    table = r["encoders"].table(1)
    return [table.numbers(column, row[0], encoder)[0] for row in table.rows if row[1] == encoder]


def learned(r: Results) -> list[float]:
    """Return the number of objects where the learned encoder beats pixels, of all objects, and the mean error ratio."""
    found = ratios(encoded(r, "moco", "best-1"), encoded(r, "pixel", "best-1"))
    return [sum(ratio < 1 for ratio in found), len(found), geometric_mean(found)]


def seven_contacts(r: Results) -> list[float]:
    """Return the ranges of the normalised errors of contact alone and of their ratios to best-1, with 7 contacts."""
    table = r["paper-contacts"].table(1)
    lines = ("kinematic", "best-1")
    alone, best = ([table.numbers("7", *row[:3]) for row in table.rows if row[2] == line] for line in lines)
    return [*ends([a[1] for a in alone]), *ends(ratios([a[0] for a in alone], [b[0] for b in best]))]


def sure_lists(r: Results) -> list[float]:
    """Return the number of right poses with a probability of at least 95 %, and of all of them."""
    table = r["vision_lists"].table(1)
    rows = [table.numbers("right at 95 %", row[0]) for row in table.rows]
    return [sum(row[k] for row in rows) for k in (0, 1)]


def second_contact(r: Results) -> list[float]:
    """Return the median errors on the hook with one contact and with two, mm."""
    return [r.at("paper-contacts", 1, count, "hook", "39728", "best-1")[0] for count in "12"]


def outliers(r: Results, column: str) -> list[tuple[bool, str, int]]:
    """Return (has an outlier, kind of touches, number in the column) for each row of the table of outliers."""
    table = r["contacts-outliers"].table(1)
    touches = accumulate((row[1] for row in table.rows), lambda above, cell: cell or above)
    place = table.find_column(column)
    return [(row[2] != "none", word, int(row[place])) for row, word in zip(table.rows, touches, strict=True)]


def wrongly(r: Results) -> list[float]:
    """Return the number of right touches named in examples without a wrong touch, and the numbers of examples.

    The examples without a wrong touch come first, then those with one.
    """
    without, with_one = ([n for one, _, n in outliers(r, "wrongly") if one is which] for which in (False, True))
    if sum(with_one):
        raise ValueError("a right touch was named beside a wrong one; change the sentence")
    return [sum(without), EXAMPLES * len(without), EXAMPLES * len(with_one)]


def named(r: Results) -> list[float]:
    """Return the number of named wrong touches and of examples, for clean touches, then for shifted ones."""
    counts = [[n for one, touches, n in outliers(r, "named") if one and touches == which] for which in ("clean", "off")]
    return [value for some in counts for value in (sum(some), EXAMPLES * len(some))]


def count_touches(run: str, column: str, *methods: str) -> Values:
    """Return a function that returns the numbers of touches of methods, over all objects."""
    return lambda r: [r.at(run, 1, f"{method}: {column}", "all")[0] for method in methods]


def worse_found(r: Results) -> list[float]:
    """Return by how much, in %, found labels have larger errors than labels by hand, for the last two sets."""
    columns = ("found on hand", "hand on hand")
    pairs = ([r.at("found_labels", 2, column, name)[0] for column in columns] for name in ("160 x 120", "FOTS"))
    return [100 * (found / hand - 1) for found, hand in pairs]


def start(r: Results, process: str) -> float:
    """Return the median time of a process from its start, s."""
    return r.at("startup", 1, "median, s", process)[0]


def prism_off(r: Results, run: str, number: int, *kind: str) -> list[float]:
    """Return the greatest error of a located prism's place, mm, and of its yaw, degrees, in the rows of a kind."""
    table = r[run].table(number)
    rows = [row for row in table.filled if tuple(row[1 : 1 + len(kind)]) == kind]
    x, y, yaw = (
        [float(row[table.find_column(name)]) for row in rows] for name in ("x off, mm", "y off, mm", "yaw off, °")
    )
    return [max(map(hypot, x, y)), max(map(abs, yaw))]


def prism_searched(r: Results) -> list[float]:
    """Return the errors of the prism, mm and degrees, if the whole object is searched, with the default refiner."""
    return prism_off(r, "elastic_reading", 3, "layer", "joint")


SETTINGS = {
    "README.md": ("Python 3.11 to 3.13", "In simulation, 14 parts"),
    "docs/benchmarks.md": ("The median error is below 0.01 mm on most parts", "with Python 3.11, on x86-64 servers"),
}
FINGER: dict[str, Values] = {
    "follows the finger {} to {} times a second": range_of("app", 1, "updates/s"),
    "The largest mesh has {} triangles": lambda r: [max(r.column("app", 1, "triangles"))],
}
QUOTES: dict[str, dict[str, Values]] = {
    "README.md": {
        "The touches determine the pose in {} % of the cases, and {} % of these are located within 0.5 mm. Of all "
        "cases, {} % are":
            lambda r: [100 - r.at("contacts-clean", 2, "undetermined", "all 14", "3")[0], five_located(r)[1],
                       five_located(r)[3]],
        "With strong noise, {} % are located within 1 mm":
            lambda r: r.at("contacts-strong", 2, "1 mm", "all 14", "3"),
        "Of {} answers with the verdict `certain`, {} were wrong by more than 1 mm": certain_wrong,
        "Locating takes {} to {} ms on two CPU cores": times_together("3"),
        "the place was off by at most {} mm and the yaw by at most {} degrees": prism_searched,
    },
    "docs/benchmarks.md": {
        "The 95 % credible sets contain the true pose for {} to {} % of the touches": range_of("paper", 2, "95 %"),
        "| clean touches, determined cases | {} % | {} % | {} % |": lambda r: five_located(r)[:3],
        "| clean touches, all cases | {} % | {} % | {} % |":
            lambda r: [r.at("contacts-clean", 1, touches, "all 14")[0] for touches in "235"],
        "| sensor poses off by 0.5 mm and 0.5°, all cases | {} % | {} % | {} % |":
            lambda r: [r.at("contacts-misplaced", 1, f"{touches}: within 0.5 mm", "all 14")[0] for touches in "235"],
        "| strong noise, all cases | not measured | {} % | {} % |":
            lambda r: [r.at("contacts-strong", 1, touches, "all 14")[0] for touches in "35"],
        "10 000 poses, one touch). Without noise, the median error is {} to {} mm on seven of nine": one_touch,
        "With strong noise, the median error is {} to {} mm on the six demo objects":
            lambda r: ends(r.column("paper", 1, "chosen")),
        "from its mesh by 0.1 mm** (three demo objects, GelSight Mini). With one touch of a known face, the error is "
        "below 1 mm in {} to {} % of the examples, instead of {} % with an exact mesh":
            lambda r: outside(r, "1", DRAWN[2], DRAWN[3], DRAWN[0]),
        "With three touches from any direction, it is below 1 mm in {} to {} %, instead of {} %":
            lambda r: outside(r, "3", DRAWN[2], DRAWN[3], DRAWN[0]),
        "Of {} answers with the verdict `certain`, {} were wrong": certain_wrong,
        "its place was off by at most {} mm, and its yaw by at most {}°":
            lambda r: prism_off(r, "real_images-shapes", 4),
        "they were off by at most {} mm and {}°": prism_searched,
        "sensors read the shape of a pressed ball to {} mm":
            lambda r: [r.at("real_images", 1, "shape in the contact", "GelSlim, 320 x 320")[0] / 1000],
        "draws {} to {} contact shapes a second": lambda r: renderer(r, -3, 0),
        "{} to {} times as many as OpenGL": lambda r: renderer(r, 0, 1),
    },
    "docs/contacts.md": {"a second contact reduces the median error from {} to {} mm": second_contact},
    "docs/method.md": {
        "has {} (a round part) to {} places":
            lambda r: [round(end(r.column("search-parts", 1, "places")), n) for end, n in ((min, -2), (max, -3))],
    },
    "docs/identify.md": {
        "A floor counts at most {} nats": lambda r: [NullEvidence().noise],
        "divided by 1 + {} times the floors": lambda r: [NullEvidence().growth],
        "If the result is above {} nats": lambda r: [NullEvidence().gap],
        "explained by chance: {} % after one touch, and {} % of these":
            lambda r: [100 * NullEvidence().chance, 100 * NullEvidence().again],
        "unknown with a probability of {} %": lambda r: [100 * NullEvidence().prior],
    },
    "docs/app.md": FINGER,
    "docs/quickstart.md": {
        "{} MB for the hook": lambda r: r.at("search", 1, "MB", "hook"),
        "With three touches, it takes {} to {} s on two idle cores (pin and hook)":
            lambda r: ends([start(r, f"first `tactile-loc run` of the {name}, compiled") for name in ("pin", "hook")]),
        "and later runs take {} s": lambda r: [start(r, "`tactile-loc run` again")],
        "the very first run takes {} s": lambda r: [start(r, "first `tactile-loc run`")],
    },
    "docs/benchmarks/accuracy.md": {
        "Every model is built in {} to {} s": range_of("single_touch", 1, "build s"),
        "Encoding, matching and refining one pose take {} to {} ms":
            lambda r: ends([sum(r.at("single_touch", 1, "ms: encode, match, refine", row[0]))
                            for row in r["single_touch"].table(1).rows]),
        "(*chosen*) is {} to {} mm off on seven of the nine": one_touch,
        "The best of their ten most probable poses has {} and {} times the error of *closest*":
            lambda r: [r.at("single_touch", 1, "best-10", name)[0] / r.at("single_touch", 1, "closest", name)[0]
                       for name in ("AutoMate 00308_plug", "pulley (MBRFA30)")],
        "**If two, three or five touches determine the pose, {}, {} and {} % of the examples are located within "
        "0.5 mm.** Of all examples, {} % are located within 0.5 mm with three touches, and {} % with "
        "five": five_located,
        "A correct touch is reported as wrong in {} of {} examples without a wrong touch, and in none of {} "
        "examples": wrongly,
        "the wrong touch is reported in {} of {} examples. With slightly misplaced sensors, it is reported "
        "in {} of {}": named,
        "ten touches determine the mount's position to {} mm and its rotation to {} degrees":
            lambda r: [r.at("mount", 1, place, "mild", "10")[0] for place in (3, 4)],
        "on the hook the median error falls from {} to {} mm": second_contact,
        "With seven contacts, contact alone still has {} to {} times a random pose's error. The error of "
        "best-1 is {} to {} times smaller": seven_contacts,
    },
    "docs/benchmarks/outside-the-model.md": {
        "within 1 mm in {} % of the examples with the same mesh, {} and {} % with scans, {} % decimated, {} % with the "
        "unseen noise": lambda r: outside(r, "3", *DRAWN),
        "Their median error grows from {} mm to the error of the mesh or more":
            lambda r: medians_outside(r, DRAWN[0])[1:],
        "{} to {} mm with scans, {} to {} mm decimated":
            lambda r: [*medians_outside(r, *DRAWN[1:3]), *medians_outside(r, DRAWN[3])],
        "With one touch, poses are within 1 mm in {} % with the same mesh, {} and {} % with scans, {} % "
        "decimated, {} % with the "
        "unseen noise": lambda r: outside(r, "1", *DRAWN),
    },
    "docs/benchmarks/probabilities.md": {
        "The worst are the 50 % sets of one touch, which hold {} %":
            lambda r: r.at("credible_sets", 1, "fused: 50, 80, 95 %", "1")[:1],
        "The 95 % sets contain the true pose of {} to {} % of the touches": range_of("paper", 2, "95 %"),
        "On the six objects, they contain the true pose of {} to {} % of the touches": range_of("paper", 2, "50 %"),
        "{} to {} % of the true poses, instead of 5 %, are outside the 95 % ellipsoid":
            lambda r: ends([100 - share for share in r.column("covariances", 1, "in 95 %")]),
    },
    "docs/benchmarks/components.md": FINGER | {
        "On {} of {} objects, the learned encoder has a smaller best-1 error than pixels. The ratio of the "
        "errors is {}":
            learned,
        "The best of the learned encoder's ten most probable poses has at most {} times the nearest grid pose's error":
            lambda r: [max(ratios(encoded(r, "moco", "best-10"), encoded(r, "moco", "closest")))],
        "The refined first pose is {} mm off with the learned encoder, and {} mm off with pixels":
            lambda r: [median(encoded(r, encoder, "reg-1")) for encoder in ("moco", "pixel")],
        **{f"| {name}, {line} | {paper} | {{}} | {{}} |": beside_the_paper(name, line) for name, line, paper in PAPER},
    },
    "docs/benchmarks/tasks.md": {
        "Locating each frame alone takes {} to {} times as long as tracking it":
            lambda r: ends(ratios(*(r.column("sequences", 1, "time, ms (99 %)")[k::3] for k in (1, 0)))),
        "The head on GelSlim is located to {} mm": lambda r: r.at("replay", 1, "error, mm (90 %)", "head", "none")[:1],
        "the journal and writing cost {} to {} ms for each image": range_of("replay", 1, "beside locating, ms"),
        "the best possible touches need {} touches, chosen ones {}, and random ones {}":
            count_touches("next_touch", "known", "oracle", "chosen", "random"),
        "Until the verdict is also certain, they need {}, {} and {} touches":
            count_touches("next_touch", "certain", "oracle", "chosen", "random"),
        "Chosen touches thus need {} and {} times as many touches":
            lambda r: r.at("next_touch", 1, "chosen: x oracle", "all"),
        "needs {} touches until the first pose is right, and {} until the verdict is also certain": lambda r: [
            r.at("next_touch-expected", 1, f"expected: {column}", "all")[0] for column in ("known", "certain")
        ],
        "Chosen touches need {} and {}": lambda r: [
            r.at("next_touch-expected", 1, f"chosen: {column}", "all")[0] for column in ("known", "certain")
        ],
        "identified as another part in {} % of the examples":
            lambda r: [100 - r.at("identify", 1, "unknown: rejected", "2")[0]],
    },
    "docs/vision.md": {
        "The right pose of ten was first in {} % of the lists before the touch, and in {} % after it": lambda r: [
            mean(r.column("vision_lists", 1, column)) for column in ("first before", "first after")
        ],
        "this pose was right in {} of {} lists": sure_lists,
        "The first pose of plug 01053 is right in {} %":
            lambda r: r.at("vision_lists", 1, "first after", "01053_plug")[:1],
    },
    "docs/benchmarks/real-images.md": {
        "the error with five spread presses is {}, {}, {} and {} times that with all presses": presses("5", 1),
        "With ten spread presses, it is {}, {}, {} and {} times": presses("10", 1),
        "With five random presses, it is {}, {}, {} and {} times": presses("5", 0),
        "On the other two sets, the error is larger by {} and {} %": worse_found,
    },
}  # fmt: skip
