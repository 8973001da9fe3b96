"""The page of a study: the part's surface coloured by the results, the shares, the pairs and the features."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tactile_loc import Page, Section, TriangleMesh, frame_surface, simplify_mesh
from tactile_loc.commands import format_count, format_mm, pack_array

from tactile_loc_touchability.details import Findings
from tactile_loc_touchability.features import RADIUS_M
from tactile_loc_touchability.rivals import choose_marks
from tactile_loc_touchability.study import RIGHT_M, Study
from tactile_loc_touchability.together import CONFIRMED, average_nearby
from tactile_loc_touchability.words import write_place, write_share

Floats = NDArray[np.float64]

FACES, EDGES = 15_000, 45  # most triangles of the drawn surface; its longest edges per diameter
UNREACHED, NEAR = -1.0, 0.12  # value of faces that no press is near, within this share of the diameter
MARKS, LIFT = 5, 0.02  # marks of a pair; their height above the surface, as a share of the diameter
VIEW = np.array([0.62, -0.62, 0.48])  # from which the part is seen at first
SHARES = ("touches", "simulated", "certain (%)", "within 1 mm (%)", "certain but wrong (%)", "no feature (%)")
MAP_NOTE = (
    "A place has the mean result of the simulated touches near it whose surface faces alike. A press that shows no "
    "feature, such as on a flat face, has the part's diameter as its pose error. Colours by pair: the share of places "
    "near this one at which one touch tells the two poses of the pair apart."
)
SHARES_NOTE = (
    "Touches at random places, which one result locates together. certain: results with this verdict. within 1 mm: "
    "results whose first pose is right. no feature: results without any touch that shows an edge or a feature."
)
BEST_NOTE = (
    f"Each was located {CONFIRMED} times, with other noise, and with presses off by about 1 mm and 3 degrees. The "
    "sensor's poses relative to each other are known, as on a robot."
)
PAIRS_NOTE = (
    "Two poses that explain touches equally well. The second pose follows from the first by a motion of the part, in "
    "the mesh's frame. The last column is the share of places at which one touch, at a known sensor pose, has at least "
    "1 nat of evidence for one of the two poses."
)
FEATURES_NOTE = (
    f"Balls of {2e3 * RADIUS_M:g} mm diameter, half of them in the part, were added to the mesh or cut from it, for "
    "the pair of poses that most touches confuse. The columns are the share of places that tell this pair apart."
)


def make_touchability_page(studies: Sequence[Study], found: Findings, answer: str) -> Page:
    """Return the page of studies of one object. The map and the details are those of the study of `found`."""
    study, obj = found.study, found.study.localizer.object
    maps, data = draw_maps(found)
    rows = [[one.name, *cells] for one in studies for cells in list_share_cells(one)]
    about = f"{obj.name}, symmetry {obj.symmetry}, diameter {format_mm(study.diameter_m)} mm; {study.name}"
    sections = [
        Section("summary", "", {"numbers": list_numbers(study), "answer": answer}),
        Section("map", "What one touch tells, by place", {"names": maps, "note": MAP_NOTE}),
        Section(
            "shares",
            "Sensors, presses and numbers of touches",
            {"header": ["sensor, press", *SHARES], "rows": rows, "note": SHARES_NOTE},
        ),
        Section(
            "best",
            "The best touches together",
            {
                "header": ["place", "at (mm)", "sets", "certain (%)", "within 1 mm (%)"],
                "rows": list_best_cells(found),
                "note": BEST_NOTE,
            },
        ),
        Section(
            "pairs",
            "Poses that touches confuse",
            {
                "header": ["pair", "second pose", "reason", "fit both (%)", "places that tell them apart (%)"],
                "rows": list_pair_cells(found),
                "note": PAIRS_NOTE,
            },
        ),
        Section(
            "features",
            "Where a small feature would help",
            {
                "header": ["feature", "at (mm)", "told apart before (%)", "with it (%)"],
                "rows": list_feature_cells(found),
                "note": found.no_feature or FEATURES_NOTE,
            },
        ),
        Section("made", "Settings", {"settings": list_settings(study)}),
    ]
    return Page(
        "touchability",
        f"Touchability: {obj.name}",
        about,
        sections,
        data,
        ["solids.js", "touchability.js"],
        package=__package__,
    )


@dataclass(frozen=True, eq=False)
class ColouredMap:
    """What colours the surface: a value (N,) of each press, up to `high`, and `marks` on the surface."""

    name: str
    label: str
    values: Floats
    high: float
    marks: Mapping[str, Any]
    good_last: bool = True


def draw_maps(found: Findings) -> tuple[dict[int, str], dict[str, Any]]:
    """Return the names of the maps, and the page's data: the surface, and each map's values of its triangles."""
    study, maps = found.study, list_maps(found)
    mesh = subdivide(study.localizer.object.mesh, study.diameter_m / EDGES)
    centres_m, normals = mesh.triangles_m.mean(axis=1), mesh.face_normals
    apart = np.linalg.norm(centres_m[:, None] - study.presses.places_m[None], axis=-1)
    reached = np.where(normals @ study.presses.normals.T > 0, apart, np.inf).min(axis=1) < NEAR * study.diameter_m
    packed = []
    for one in maps:
        shown = np.clip(average_nearby(study, one.values, centres_m, normals), 0.0, one.high)
        values = pack_array(np.where(reached, shown, UNREACHED), "<f4")
        about = {"high": one.high, "label": one.label, "marks": one.marks, "goodLast": one.good_last}
        packed.append({"values": values, **about})
    names = {k: one.name for k, one in enumerate(maps)}
    return names, {"maps": packed, **frame_surface(mesh, mesh.centroid_m + VIEW)}


def list_maps(found: Findings) -> list[ColouredMap]:
    """Return the maps: the pose error, the shares that end certain and right, and each pair of poses."""
    study = found.study
    best = found.best[-1].presses if found.best else ()
    numbered = mark(study, best, [str(k) for k in range(1, 1 + len(best))])
    errors_mm, certain = 1e3 * study.errors_m, np.where(study.certain, 100.0, 0.0)
    right = np.where(study.errors_m <= RIGHT_M, 100.0, 0.0)
    maps = [
        ColouredMap("expected pose error", "mm", errors_mm, 1e3 * study.diameter_m, numbered, good_last=False),
        ColouredMap("certain after one touch", "%", certain, 100.0, numbered),
        ColouredMap("within 1 mm after one touch", "%", right, 100.0, numbered),
    ]
    for k, pair in enumerate(found.pairs, 1):
        some = choose_marks(study.presses.places_m, pair.told, MARKS)
        told, marks = np.where(pair.told, 100.0, 0.0), mark(study, some, ["here"] * len(some))
        maps.append(ColouredMap(f"pair {k}: {pair.words}", "% told apart", told, 100.0, marks))
    return maps


def subdivide(mesh: TriangleMesh, edge_m: float) -> TriangleMesh:
    """Return a mesh with at most about FACES triangles, of which large ones are divided to edges of `edge_m` metres."""
    import trimesh

    if len(mesh.faces) > FACES:
        return simplify_mesh(mesh, FACES)
    vertices_m, faces = mesh.vertices_m, mesh.faces
    divide: Any = trimesh.remesh.subdivide_to_size
    for longest_m in (4 * edge_m, 2 * edge_m, edge_m):
        finer = divide(mesh.vertices_m, mesh.faces, longest_m, max_iter=20)
        if len(finer[1]) > FACES:
            break
        vertices_m, faces = finer[0], finer[1]
    return TriangleMesh(np.asarray(vertices_m, float), np.asarray(faces, np.int64))


def mark(study: Study, presses: Sequence[int], texts: Sequence[str]) -> dict[str, Any]:
    """Return texts a little above the places of presses, mm."""
    some = list(presses)
    at = 1e3 * (study.presses.places_m[some] + LIFT * study.diameter_m * study.presses.normals[some])
    return {**{name: at[:, k].round(3).tolist() for k, name in enumerate("xyz")}, "text": list(texts)}


def list_numbers(study: Study) -> list[tuple[str, str, str]]:
    """Return the main numbers: the shares that end certain, by the number of touches."""
    numbers = [
        (
            f"certain after {format_count(one['touches'], 'touch')}",
            write_share(one["certain"]),
            f"of {one['sets']} {'touches' if one['touches'] == 1 else 'sets of touches'} at random places; "
            f"{write_share(one['right'])} within 1 mm",
        )
        for one in study.list_shares()
    ]
    reach = "of the surface is touched by a gel that comes along the normal or tilted"
    return [*numbers, ("within reach", write_share(study.presses.reached), reach)]


def list_share_cells(study: Study) -> list[list[str]]:
    """Return the cells of SHARES for each number of touches."""
    shown = ("certain", "right", "wrong", "nothing")
    return [
        [str(one["touches"]), str(one["sets"]), *(f"{100 * one[name]:.1f}" for name in shown)]
        for one in study.list_shares()
    ]


def list_best_cells(found: Findings) -> list[list[str]]:
    """Return a row for the best press, the best two, and so on."""
    rows = []
    for one in found.best:
        places = "; ".join(write_place(found.study.presses.places_m[k]) for k in one.presses)
        shares = [f"{100 * one.shares[name]:.0f}" for name in ("certain", "right")]
        numbers = "one" if len(one.presses) == 1 else f"{len(one.presses)} together"
        rows.append([numbers, places, str(one.shares["sets"]), *shares])
    return rows


def list_pair_cells(found: Findings) -> list[list[str]]:
    """Return a row for each pair of poses."""
    return [
        [str(k), pair.words, pair.reason, f"{100 * pair.confused.mean():.1f}", f"{100 * pair.told.mean():.1f}"]
        for k, pair in enumerate(found.pairs, 1)
    ]


def list_feature_cells(found: Findings) -> list[list[str]]:
    """Return a row for each tried feature."""
    return [
        [one.kind, write_place(np.array(one.place_m)), f"{100 * one.before:.1f}", f"{100 * one.after:.1f}"]
        for one in found.features
    ]


def list_settings(study: Study) -> list[list[str]]:
    """Return the settings of a study."""
    tilt = f"up to {np.degrees(study.options.tilt_rad):.0f}° from the surface's normal"
    return [
        ["sensor, press", study.name],
        ["directions", tilt],
        ["noise", study.options.noise],
        ["touches drawn by", study.options.renderer],
        ["seed", str(study.options.seed)],
    ]
