#!/usr/bin/env python3
"""Run the numerical tests as on other processors: with other instruction sets for numba, numpy, BLAS, torch and faiss.

`make test-processors` runs all variants that this processor can compute. Each has a folder of its own for compiled
code. First, each variant locates the same touches. Verdicts and certain poses must be those of this processor.
`--by-commit` runs one variant, chosen by the hash of the commit. Arguments after `--` replace those of pytest.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
NUMERICAL = ("bases", "core", "evaluation", "locate", "planning", "plugins", "simulate", "slots", "tracking")
FOLDERS = [
    *(f"tests/{name}" for name in NUMERICAL),
    *(f"plugins_contrib/tactile-loc-{name}/tests" for name in ("benchmark", "library")),
]
PYTEST = ["-q", "-n", "2", "--dist", "loadfile", "--no-loadscope-reorder", "-m", "not slow", *FOLDERS]
NUMPY_LEVELS = ("X86_V2", "X86_V3", "X86_V4", "AVX512_ICL", "AVX512_SPR")  # the features that numpy has code for
BEYOND_AVX2 = "X86_V4 AVX512_ICL AVX512_SPR"  # numpy's names of groups of features
OBJECTS, TOUCHES = ("hook", "pin", "damping_pin", "cotter"), (1, 1, 2, 3)  # whose touches are located by each variant
SAME_M = 1e-6  # largest distance of two poses that are the same, up to symmetry
AVX512 = {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}


@dataclass(frozen=True)
class Variant:
    """A processor to imitate, by its names in LLVM and OpenBLAS and by the features that numpy must not use.

    `needs` are LLVM's names of features without which this processor cannot compute the variant.
    """

    name: str
    needs: frozenset[str]
    llvm: tuple[str, str]
    disabled: str
    blas: str
    level: str  # of torch and faiss

    @property
    def environment(self) -> dict[str, str]:
        """The variables that choose the variant."""
        return {
            "NUMBA_CPU_NAME": self.llvm[0],
            "NUMBA_CPU_FEATURES": self.llvm[1],
            "NUMBA_CACHE_DIR": str(ROOT / "out" / "processors" / self.name),
            "NPY_DISABLE_CPU_FEATURES": self.disabled,
            "OPENBLAS_CORETYPE": self.blas,
            "ATEN_CPU_CAPABILITY": {"generic": "default"}.get(self.level, self.level),
            "FAISS_OPT_LEVEL": self.level,
        }


VARIANTS = (
    Variant("sse2", frozenset({"sse2"}), ("generic", "+sse2"), f"X86_V3 {BEYOND_AVX2}", "Nehalem", "generic"),
    Variant("haswell", frozenset({"avx2", "bmi2", "fma"}), ("haswell", ""), BEYOND_AVX2, "Haswell", "avx2"),
    Variant("skylake-avx512", frozenset(AVX512), ("skylake-avx512", ""), "AVX512_ICL AVX512_SPR", "SkylakeX", "avx512"),
    Variant(
        "znver4",
        frozenset(AVX512 | {"avx512bf16", "avx512vbmi2", "sse4a"}),
        ("znver4", ""),
        "AVX512_SPR",
        "Zen",
        "avx2",
    ),
)


def read_features(environment: dict[str, str]) -> dict[str, Any]:
    """Return the features that the libraries use in an environment."""
    return dict(_read_json("--features", environment))


def _read_json(option: str, environment: dict[str, str]) -> Any:
    """Return what this program prints with an option in an environment."""
    variables = {**os.environ, **environment}
    found = subprocess.run([sys.executable, __file__, option], env=variables, stdout=subprocess.PIPE, check=True)
    return json.loads(found.stdout)


def print_answers() -> None:
    """Locate simulated touches, and print the verdict and the first pose of each example, as JSON.

    A pose is the points (K, D), metres, of `PoseMetric.embed_orbits`.
    """
    from tactile_loc import Localizer
    from tactile_loc.core.poses.metric import PoseMetric
    from tactile_loc.locate.several_touches import localize_together

    found = {}
    with tempfile.TemporaryDirectory() as store:
        for name in OBJECTS:
            localizer = Localizer.create(name, sensor="gelslim", store=store)
            for seed, count in enumerate(TOUCHES):
                touches = localizer.simulate_together(count, seed)
                result = localize_together([(localizer, touch) for touch in touches])
                orbit = PoseMetric(localizer.object).embed_orbits(result.best.T_sensor_object[None])[:, 0]
                found[f"{name}, seed {seed}, touches: {count}"] = [str(result.verdict), orbit.tolist()]
    print(json.dumps(found))


def compare_answers(expected: dict[str, Any], found: dict[str, Any]) -> list[str]:
    """Return the names of the examples whose verdict or certain pose differs. Other poses may be one of many."""
    different = []
    for name, (verdict, orbit) in expected.items():
        off_m = np.linalg.norm(np.subtract(found[name][1], orbit[0]), axis=-1).min()
        if found[name][0] != verdict or (verdict == "certain" and off_m > SAME_M):
            different.append(name)
    return different


def print_features() -> None:
    """Print the features that numba, numpy and BLAS use in this process, as JSON."""
    import scipy.linalg  # noqa: F401 - it has a BLAS library of its own
    from numba.core.registry import cpu_target
    from numpy._core._multiarray_umath import __cpu_features__ as numpy_features
    from threadpoolctl import threadpool_info

    _, name, features = cpu_target.target_context.codegen().magic_tuple()
    blas = sorted(f"{one['internal_api']} {one.get('architecture', '')}" for one in threadpool_info())
    levels = [level for level in NUMPY_LEVELS if numpy_features.get(level)]
    print(json.dumps({"numba": [name, features], "numpy": levels, "blas": blas}))


def list_host_features() -> set[str]:
    """Return LLVM's names of the features of this processor."""
    import llvmlite.binding as llvm

    return {name for name, has in llvm.get_host_cpu_features().items() if has}


def choose_variants(names: list[str], by_commit: bool) -> list[Variant]:
    """Return the variants to run. Report the variants that this processor cannot compute, or that change nothing."""
    plain, host = read_features({}), list_host_features()
    able = []
    for variant in VARIANTS:
        if names and variant.name not in names:
            continue
        missing = variant.needs - host
        if missing:
            print(f"processors: {variant.name} is skipped, because this processor lacks {', '.join(sorted(missing))}")
        elif (features := read_features(variant.environment)) == plain:
            print(f"processors: {variant.name} is skipped, because it changes nothing on this processor")
        else:
            print(f"processors: {variant.name}: numba {features['numba'][0]}, numpy {', '.join(features['numpy'])}, "
                  f"{', '.join(features['blas'])}", flush=True)  # fmt: skip
            able.append(variant)
    if not able:
        sys.exit("processors: no variant changes the instruction sets of this processor, so nothing was tested")
    if by_commit:
        head = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
        able = [able[int(head.strip(), 16) % len(able)]]
    return able


def run(variant: Variant, expected: dict[str, Any], arguments: list[str]) -> bool:
    """Compare the answers of a variant with those expected, run pytest in it, and return whether all is right."""
    threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    different = compare_answers(expected, _read_json("--answers", variant.environment))
    count = f"{len(different)} of {len(expected)} answers differ"
    print(f"processors: {variant.name}: {'; '.join([count, *different])}", flush=True)
    command, environment = (
        [sys.executable, "-m", "pytest", *arguments],
        {**os.environ, **threads, **variant.environment},
    )
    return not different and subprocess.run(command, cwd=ROOT, env=environment).returncode == 0


def main() -> None:
    """Run the chosen variants; the exit code is 1 if a test failed in any of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--variant", action="append", default=[], choices=[one.name for one in VARIANTS])
    parser.add_argument("--by-commit", action="store_true", help="run one variant, chosen by the commit's hash")
    parser.add_argument("--features", action="store_true", help="print the features in force and end")
    parser.add_argument("--answers", action="store_true", help="print the answers to simulated touches and end")
    parser.add_argument("pytest", nargs="*", help="arguments of pytest, after --")
    given = parser.parse_args()
    if given.features or given.answers:
        print_features() if given.features else print_answers()
        return
    variants = choose_variants(given.variant, given.by_commit)
    expected = _read_json("--answers", {})
    failed = [variant.name for variant in variants if not run(variant, expected, given.pytest or PYTEST)]
    print(f"processors: passed: {', '.join(one.name for one in variants if one.name not in failed) or 'none'}")
    if failed:
        sys.exit(f"processors: tests failed as on {', '.join(failed)}")


if __name__ == "__main__":
    main()
