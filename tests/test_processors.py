"""The variants of other processors change the features in force; variants that this one lacks are skipped by name."""

import processors
import pytest


@pytest.fixture
def plain(monkeypatch):
    """Features that only the variant `haswell` leaves as they are."""

    def read_features(given: dict[str, str]) -> dict[str, list[str]]:
        return {"numba": [given.get("NUMBA_CPU_NAME", "haswell")], "numpy": [], "blas": []}

    monkeypatch.setattr(processors, "read_features", read_features)


def choose(names=(), by_commit=False) -> list[str]:
    return [one.name for one in processors.choose_variants(list(names), by_commit)]


def test_variants_without_effect_or_beyond_the_processor_are_skipped_by_name(plain, monkeypatch, capsys):
    monkeypatch.setattr(processors, "list_host_features", lambda: {"sse2", "avx2", "bmi2", "fma"})
    assert choose() == ["sse2"]
    said = capsys.readouterr().out
    assert all(name in said for name in ("haswell", "skylake-avx512", "znver4", "avx512f", "sse4a"))


def test_a_commit_chooses_one_variant(plain, monkeypatch):
    monkeypatch.setattr(processors, "list_host_features", lambda: set().union(*(v.needs for v in processors.VARIANTS)))
    assert len(choose()) == 3
    assert len(choose(by_commit=True)) == 1


def test_a_variant_changes_the_features_in_force():
    sse2 = processors.VARIANTS[0]
    features = processors.read_features(sse2.environment)
    assert features != processors.read_features({})
    assert features["numba"] == ["generic", "+sse2"]
    assert not {"X86_V3", "X86_V4"} & set(features["numpy"])


def test_answers_differ_if_a_verdict_or_a_certain_pose_does():
    near, far = [[0.0, 0.0], [1.0, 0.0]], [[0.0, 1.0], [1.0, 1.0]]
    expected = {"a": ["certain", near], "b": ["certain", near], "c": ["ambiguous", near], "d": ["ambiguous", near]}
    found = {"a": ["certain", near], "b": ["certain", far], "c": ["ambiguous", far], "d": ["certain", near]}
    assert processors.compare_answers(expected, found) == ["b", "d"]


def test_the_folders_of_numerical_tests_exist():
    assert [folder for folder in processors.FOLDERS if not (processors.ROOT / folder).is_dir()] == []
