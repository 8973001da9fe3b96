"""What is mutated, and which tests judge it: those that mirror the files, kept quick, not the whole suite."""

from __future__ import annotations

from dataclasses import dataclass

NOUNS = "tests/test_nouns.py"
STORE = ("artifact", "files", "keys", "line_files", "store", "workspace")
SLOW = "imprint or first_use or dense or sizes"  # without a compiler, or of renderers and sensors
PROCESSES = "any_step or two_processes or killed_build"  # several, started one after the other


@dataclass(frozen=True)
class Target:
    """Files of tactile_loc that are mutated together, and the tests that judge them: files and options of pytest."""

    name: str
    files: tuple[str, ...]
    tests: tuple[str, ...]

    def tests_of(self, file: str) -> tuple[str, ...]:
        """The tests in the order in which they judge a file's mutants: those that mirror it first."""
        mirror = f"/test_{file.rpartition('/')[2]}"
        return tuple(sorted(self.tests, key=lambda test: not test.endswith(mirror)))


def _core(name: str, *modules: str) -> Target:
    """Modules of core, and the tests that mirror them."""
    tests = (f"tests/core/test_{module}.py" for module in modules)
    return Target(name, tuple(f"core/{module}.py" for module in modules), (*tests, NOUNS))


TARGETS = (
    _core("geometry", "geometry"),
    Target(
        "contact",
        ("core/sensing/contact.py",),
        ("tests/core/test_contact.py", "tests/core/test_curved_contact.py", NOUNS, "-k", f"not ({SLOW})"),
    ),
    _core("poses", "poses"),
    _core("posterior", "posterior"),
    Target(
        "fusing",
        ("core/slots/common_poses.py", "plugins/fusers/product.py", "plugins/fusers/kinematic.py"),
        ("tests/core/test_common_poses.py", "tests/plugins/fusers", NOUNS),
    ),
    _core("covariance", "objects", "hand_eye", "pose_filter"),
    Target(
        "store",
        tuple(f"store/{name}.py" for name in STORE),
        (*(f"tests/store/test_{name}.py" for name in STORE), NOUNS, "-k", f"not ({PROCESSES})"),
    ),
)
