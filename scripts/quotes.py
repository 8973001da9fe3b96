"""What the documentation's text says of results that their tables tell, and how it is computed from them.

`{}` stands for a figure; it is written as the text likes, with as many decimals, or rounded to thousands. A quote
without values has figures of no table: settings, and what was measured beside them.
"""

from __future__ import annotations

from collections.abc import Sequence
from statistics import geometric_mean, mean, median

from figures import Quote, Results

README, CONTACTS, METHOD = "README.md", "docs/contacts.md", "docs/method.md"
BENCHMARKS, EVALUATION = "docs/benchmarks.md", "docs/evaluation.md"
MOST_DOUBTED = "the 12 in most doubt after the first touch"
DRAWN = ("same mesh", "scanned, 0.05 mm", "scanned, 0.1 mm", "decimated, 0.1 mm", "unseen noise")
PARTS_APART = ("pin", "damping pin", "cotter")


def ends(values: Sequence[float]) -> list[float]:
    """The least and the greatest."""
    return [min(values), max(values)]


def determined(r: Results, *touches: str) -> list[float]:
    """Of what so many clean touches determine, how much is located, %: cells are `80% (114 of 117)`."""
    cells = [r.at("contacts-clean", 1, count, "all 14") for count in touches]
    return [100 * located / of for _, located, of in cells]


def located(r: Results, *touches: str) -> list[float]:
    """How much of all examples of so many clean touches is located, %."""
    return [r.at("contacts-clean", 1, count, "all 14")[0] for count in touches]


def outside(r: Results, column: int, *drawn: str) -> list[float]:
    """Shares within 1 mm of touches that are drawn from other meshes, means over the parts, %."""
    return [mean(r.at("outside", 1, column, part, one)[0] for part in PARTS_APART) for one in drawn]


def medians_outside(r: Results, *drawn: str) -> list[float]:
    """The least and the greatest median of three touches, mm."""
    column = "three touches: median, mm"
    return ends([r.at("outside", 1, column, part, one)[0] for part in PARTS_APART for one in drawn])


def renderer(r: Results, digits: int, place: int) -> list[float]:
    """The speed of `heightmap` on parts and on demo objects, or how many times OpenGL's it is: least and greatest."""
    table = r["renderers-parts"].table(1)
    parts = [table.numbers("heightmap", *row[:2])[place] for row in table.rows]
    column, named = ("poses/s", "x pyrender")[place], r["renderers"].table(1)
    demo = [row[named.place(column)] for row in named.rows if "heightmap" in row]
    return [round(value, digits) for value in ends([*parts, *map(float, demo)])]


def one_touch(r: Results) -> list[float]:
    """How far the answers are off on the seven parts that one touch tells best, mm."""
    return ends(sorted(r.column("single_touch", 1, "chosen"))[:7])


def per_touch_ms(r: Results) -> list[float]:
    """What encoding, matching and refining one pose take together."""
    table = r["single_touch"].table(1)
    return ends([sum(table.numbers("ms: encode, match, refine", row[0])) for row in table.rows])


def over_closest(r: Results, name: str) -> float:
    """How many times as far off as the closest pose the nearest of ten is, of one touch."""
    return r.at("single_touch", 1, "best-10", name)[0] / r.at("single_touch", 1, "closest", name)[0]


def encoded(r: Results, encoder: str, column: str) -> dict[str, float]:
    """A column of an encoder's rows, by object."""
    table = r["encoders"].table(1)
    return {row[0]: table.numbers(column, row[0], encoder)[0] for row in table.rows if row[1] == encoder}


def ratio_of_encoders(r: Results) -> float:
    """How far off the learned encoder's most probable pose is, as a multiple of pixels'; mean over the objects."""
    learned, pixel = encoded(r, "moco", "best-1"), encoded(r, "pixel", "best-1")
    return geometric_mean([learned[name] / pixel[name] for name in learned])


def learned_over_closest(r: Results) -> list[float]:
    """How far off the learned encoder's ten are, as a multiple of the closest: the worst but one, and the worst."""
    ten, closest = encoded(r, "moco", "best-10"), encoded(r, "moco", "closest")
    return sorted(ten[name] / closest[name] for name in ten)[-2:]


def nearer_learned(r: Results) -> list[float]:
    """On how many objects the learned encoder's first pose is nearer, and of how many."""
    learned, pixel = encoded(r, "moco", "best-1"), encoded(r, "pixel", "best-1")
    return [sum(learned[name] < pixel[name] for name in learned), len(learned)]


def beside_the_paper(name: str, line: str, paper: str) -> Quote:
    """A row of normalised medians beside the paper's."""
    return Quote(
        EVALUATION, f"| {name}, {line} | {paper} | {{}} | {{}} |",
        lambda r: [r.at("encoders", 1, line, name, encoder)[1] for encoder in ("pixel", "moco")],
    )  # fmt: skip


def fused(r: Results, line: str, column: str, place: int) -> list[float]:
    """A column of the errors with several contacts, in mm or normalised."""
    table = r["evaluate-contacts"].table(1)
    return [table.numbers(column, *row[:4])[place] for row in table.rows if row[3] == line]


def beside_contact_alone(r: Results) -> list[float]:
    """How many times nearer seven contacts' most probable pose is than what contact alone tells."""
    both = zip(fused(r, "kinematic", "7", 0), fused(r, "best-1", "7", 0), strict=True)
    return ends([alone / best for alone, best in both])


def second_contact(r: Results) -> list[float]:
    """The median errors on the hook with one contact and with two, mm."""
    return [r.at("evaluate-contacts", 1, count, "hook", "34137", "52.0", "best-1")[0] for count in ("1", "2")]


def named(r: Results, touches: str) -> list[float]:
    """How often the wrong touch is named of touches that are clean, or off; and of how many."""
    table = r["contacts-outliers"].table(1)
    rows = _outlier_rows(r, touches)
    counts = [int(row[table.place("named")]) for row in rows if row[2] != "none"]
    return [sum(counts), _EXAMPLES * len(counts)]


_EXAMPLES = 15  # of each row of the table of outliers


def _outlier_rows(r: Results, touches: str = "") -> list[list[str]]:
    """Its rows, of some touches or all, none without its object and touches."""
    rows, last = [], ["", ""]
    for row in r["contacts-outliers"].table(1).rows:
        last = [row[0] or last[0], row[1] or last[1]]
        rows.append([*last, *row[2:]])
    return [row for row in rows if touches in ("", row[1])]


def wrongly(r: Results) -> list[float]:
    """How often a right touch is named where none is wrong, of how many; of how many where one is."""
    rows = _outlier_rows(r)
    place = r["contacts-outliers"].table(1).place("wrongly")
    without = [row for row in rows if row[2] == "none"]
    if sum(int(row[place]) for row in rows if row[2] != "none"):
        raise ValueError("a right touch was named beside a wrong one: say how often")
    return [
        sum(int(row[place]) for row in without),
        *(_EXAMPLES * len(some) for some in (without, rows[len(without) :])),
    ]


def out_of_ellipsoid(r: Results) -> list[float]:
    """How many truths are outside the 95 % ellipsoid, least and most, %."""
    return ends([100 - share for share in r.column("covariances", 1, "in 95 %")])


def more_touches(r: Results) -> list[float]:
    """How many touches are needed after the first, chosen and at random; and how many are known within three, %."""
    cells = {place: r.at("next_touch", 1, place, MOST_DOUBTED) for place in (3, 4, 6, 7)}
    return [cells[4][0] - 1, cells[7][0] - 1, cells[3][2], cells[6][2]]


def spread_presses(r: Results, column: str, way: int) -> list[float]:
    """The errors of so many presses, at random (0) or spread (1), as multiples of that of all, set by set."""
    some, every = r.column("few_presses", 1, column), r.column("few_presses", 1, "all")
    return [one / all_of_them for one, all_of_them in zip(some[way::2], every, strict=True)]


def worse_found(r: Results, column: str) -> list[float]:
    """By how much labels of the last two sets that are found, or moved, are worse than those by hand, %."""
    return [
        100 * (r.at("found_labels", 2, column, name)[0] / r.at("found_labels", 2, "hand on hand", name)[0] - 1)
        for name in ("160 x 120", "FOTS")
    ]


def alone_over_tracked(r: Results) -> list[float]:
    """How many times as long as tracking a frame locating it takes, least and most."""
    times = r.column("sequences", 1, "time, ms (99 %)")
    return ends([alone / tracker for tracker, alone in zip(times[::3], times[1::3], strict=True)])


def places(r: Results) -> list[float]:
    """How many places are listed of a part, least and most, roughly."""
    least, most = ends(r.column("search-parts", 1, "places"))
    return [round(least, -2), round(most, -3)]


def null_evidence() -> list[float]:
    """By how many nats "none of these" falls short, of one touch and of each of several."""
    from tactile_loc.tasks.identify import NullEvidence

    return [NullEvidence().alone, NullEvidence().together]


def coverage(r: Results, column: str) -> list[float]:
    """The least and the greatest share of truths in credible sets, %."""
    return ends(r.column("evaluate", 2, column))


QUOTES = (
    # README
    Quote(README, "Python 3.11 or newer"),
    Quote(README, "median error on the hook falls from {} to {} mm", second_contact),
    Quote(README, "the 95 % sets hold the truth of {} to {} % of the touches", lambda r: coverage(r, "95 %")),
    Quote(
        README,
        "Of what two, three and five clean touches determine, {}, {} and {} % is located within 0.5 mm; of "
        "all examples of three and five touches {} and {} %",
        lambda r: [*determined(r, "2", "3", "5"), *located(r, "3", "5")],
    ),
    Quote(README, "the median is below 0.01 mm on most parts"),
    Quote(
        README,
        "leaves {} % of three touches and {} % of five within 1 mm",
        lambda r: [r.at("contacts-strong", 1, place, "all 14")[0] for place in (2, 6)],
    ),
    Quote(README, "a grid of 10 000 poses: on seven of nine the pose that `run` answers is {} to {} mm off", one_touch),
    Quote(
        README,
        "With strong noise it is at {} to {} mm on the six demo objects",
        lambda r: ends(r.column("evaluate", 1, "chosen")[:6]),
    ),
    Quote(
        README,
        "A part that is 0.1 mm off its mesh costs single touches: of three demo objects with a small sensor "
        "{} to {} % instead of {} % are located within 1 mm, of three touches from any direction {} to {} % "
        "instead of {} %",
        lambda r: [value for column in (3, 5) for value in outside(r, column, DRAWN[2], DRAWN[3], DRAWN[0])],
    ),
    Quote(
        README,
        "an object is built in {} to {} s, and its probabilities are fitted in {} to {} s, once; one touch "
        "takes {} to {} s (medians)",
        lambda r: [
            *ends(r.column("search", 1, "build, s")),
            *ends(r.column("search", 1, "fit, s")),
            *(ms / 1000 for ms in ends(r.column("search", 1, "median, ms"))),
        ],
    ),
    Quote(
        README,
        "{} to {} ms of one face, {} to {} ms with one pose refined",
        lambda r: [
            value
            for row in r["first-second"].table(1).rows
            if row[0].startswith(("ten refined hypotheses of one", "the most probable pose of these"))
            for value in r.at("first-second", 1, "time", row[0])
        ],
    ),
    Quote(
        README,
        "draws {} to {} contact shapes a second, {} to {} times as many as OpenGL",
        lambda r: [*renderer(r, -3, 0), *renderer(r, 0, 1)],
    ),
    # pages of how things are done
    Quote(CONTACTS, "the median error falls from {} to {} mm with the second contact", second_contact),
    Quote(
        METHOD,
        "{} (a round part) to {} places do for",
        places,
    ),
    Quote(
        "docs/next-touch.md",
        "falls short by so many nats: {} of one touch, {} of each of several",
        lambda r: null_evidence(),
    ),
    Quote("docs/quickstart.md", "{} MB for the hook", lambda r: r.at("search", 1, "MB", "hook")),
    # docs/benchmarks.md
    Quote(BENCHMARKS, "without a GPU, Python 3.11; the date"),
    Quote(
        BENCHMARKS,
        "are of 2026-11-21, when objects were drawn where they just touch; a pressed object's outline is up to 8 % "
        "larger to the GelSlim's pinhole camera",
    ),
    Quote(
        BENCHMARKS,
        "Every model is built in {} to {} s; encoding, matching and refining one pose take {} to {} ms",
        lambda r: [*ends(r.column("single_touch", 1, "build s")), *per_touch_ms(r)],
    ),
    Quote(BENCHMARKS, "explains the touch best is at {} to {} mm on seven of the nine", one_touch),
    Quote(
        BENCHMARKS,
        "The ten most probable come within {} and {} times closest",
        lambda r: [over_closest(r, "AutoMate 00308_plug"), over_closest(r, "pulley (MBRFA30)")],
    ),
    Quote(
        BENCHMARKS,
        "most probable pose is nearer on {} of {} objects, in geometric mean at {} times the error; its ten "
        "most probable come within {} times the nearest grid pose's error on nine, {} times on the ambiguous "
        "00308. Training takes {} to {} s an object",
        lambda r: [
            *nearer_learned(r),
            ratio_of_encoders(r),
            *learned_over_closest(r),
            *ends(r.column("encoders", 1, "training")),
        ],
    ),
    Quote(
        BENCHMARKS,
        "**Of what two, three and five touches determine, {}, {} and {} % is located within 0.5 mm**; {} % of"
        " all examples of three touches and {} % of five",
        lambda r: [*determined(r, "2", "3", "5"), *located(r, "3", "5")],
    ),
    Quote(BENCHMARKS, "{} to {} % of the truths, not 5, are outside the 95 % ellipsoid", out_of_ellipsoid),
    Quote(
        BENCHMARKS,
        "ends at a median of {} mm at most",
        lambda r: [max(r.column("joint", 1, "error, mm"))],
    ),
    Quote(
        BENCHMARKS,
        "A right touch is named in {} of {} examples without a wrong one, and in none of {} with one. Of "
        "clean touches the wrong one is named in {} of {} examples, of sensors that are a little off in {} of"
        " {}",
        lambda r: [*wrongly(r), *named(r, "clean"), *named(r, "off")],
    ),
    Quote(
        BENCHMARKS,
        "ten touches tell the place to {} mm and the turn to {} degrees",
        lambda r: [r.at("mount", 1, place, "mild", "10")[0] for place in (3, 4)],
    ),
    Quote(
        BENCHMARKS,
        "The head on GelSlim is located to {} mm",
        lambda r: r.at("replay", 1, "error, mm (90 %)", "head, GelSlim")[:1],
    ),
    Quote(
        BENCHMARKS,
        "the journal and writing cost {} to {} ms an image",
        lambda r: ends(r.column("replay", 1, "beside locating, ms")),
    ),
    Quote(
        BENCHMARKS,
        "After the first touch the chosen ones need {} more, random ones {}: hardly fewer, and {} instead of "
        "{} % are known within three",
        more_touches,
    ),
    Quote(
        BENCHMARKS,
        "{} % of the left-out parts are taken for another",
        lambda r: [100 - r.at("identify", 1, "left out: rejected", "2")[0]],
    ),
    Quote(
        BENCHMARKS,
        "within 1 mm in {} % of the examples with the same mesh, {} and {} % with scans, {} % decimated, {} %"
        " with the unseen noise",
        lambda r: outside(r, 5, *DRAWN),
    ),
    Quote(
        BENCHMARKS,
        "Their median grows from {} mm to what the mesh is off, and more: {} to {} mm with scans, {} to {} mm"
        " decimated",
        lambda r: [
            medians_outside(r, DRAWN[0])[1],
            *medians_outside(r, *DRAWN[1:3]),
            *medians_outside(r, DRAWN[3]),
        ],
    ),
    Quote(
        BENCHMARKS,
        "One touch suffers: {} % with the same mesh, {} and {} % with scans, {} % decimated, {} % with the "
        "unseen noise",
        lambda r: outside(r, 3, *DRAWN),
    ),
    Quote(
        BENCHMARKS,
        "but for the 50 % sets of one touch, which hold {} %",
        lambda r: r.at("credible_sets", 1, "fused: 50, 80, 95 %", "1")[:1],
    ),
    Quote(
        BENCHMARKS,
        "Five presses that are spread come to {}, {}, {} and {} times the error of all, ten to {}, {}, {} and"
        " {}; five at random to {}, {}, {} and {}",
        lambda r: [*spread_presses(r, "5", 1), *spread_presses(r, "10", 1), *spread_presses(r, "5", 0)],
    ),
    Quote(
        BENCHMARKS,
        "On the others they are worse by {} and {} % as long",
        lambda r: worse_found(r, "found on hand"),
    ),
    Quote(
        BENCHMARKS,
        "The press depth is off by {} to {} mm on average",
        lambda r: ends(r.column("simulated_images", 1, "press off, mm")),
    ),
    Quote(BENCHMARKS, "the 95 % sets hold the truth of {} to {} % of the touches", lambda r: coverage(r, "95 %")),
    Quote(
        BENCHMARKS,
        "half of the probability holds the truth of {} to {} % of the touches",
        lambda r: coverage(r, "50 %"),
    ),
    Quote(BENCHMARKS, "Located alone, a frame takes {} to {} times as long as tracking it", alone_over_tracked),
    # docs/evaluation.md
    Quote(
        EVALUATION,
        "Contact alone stays at {} to {} of a random pose's error with seven contacts; best-1 is {} to {} times nearer",
        lambda r: [*ends(fused(r, "kinematic", "7", 1)), *beside_contact_alone(r)],
    ),
    Quote(
        EVALUATION,
        "The learned encoder's best-1 is below that of pixels on {} of {} objects, in geometric mean {} of it",
        lambda r: [*nearer_learned(r), ratio_of_encoders(r)],
    ),
    Quote(
        EVALUATION,
        "Its ten most probable poses come within {} times the nearest grid pose's error on all objects but "
        "the ambiguous 00308 ({})",
        learned_over_closest,
    ),
    Quote(
        EVALUATION,
        "the learned encoder's first pose is at {} mm in the median over the objects, pixels' at {}",
        lambda r: [median(encoded(r, encoder, "reg-1").values()) for encoder in ("moco", "pixel")],
    ),
    Quote(EVALUATION, "A training took {} to {} s", lambda r: ends(r.column("encoders", 1, "training"))),
    beside_the_paper("pin", "best-1", "0.11"),
    beside_the_paper("damping pin", "best-1", "0.16"),
    beside_the_paper("head", "best-1", "0.18"),
    beside_the_paper("elbow pipe", "best-1", "0.87"),
    beside_the_paper("elbow pipe", "best-10", "0.26"),
    beside_the_paper("elbow pipe", "best-50", "0.08"),
)
