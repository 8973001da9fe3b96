"""A run: failures, missing libraries, interruptions, and what makes a job new."""

import importlib
import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from message_helpers import missing, naming
from tactile_loc.evaluation.jobs import do_job
from tactile_loc.plugin import ConfigError, registry
from tactile_loc.slots.code import hash_code, hash_component

from tactile_loc_benchmark import job
from tactile_loc_benchmark.prepare import load_objects, prepare_source
from tactile_loc_benchmark.runner import run_benchmark


def drop_times(rows):
    return [{key: value for key, value in row.items() if key not in ("seconds", "prepared_s")} for row in rows]


def test_a_missing_library_leaves_out_its_source_or_method_with_the_line_to_install(finished):
    assert not missing(finished.results.left_out["library-source"], "nowhere_to_be_found", "pip install touch-maker")
    assert not missing(finished.results.left_out["library-method"], "nowhere_to_be_found", "pip install touch-finder")
    assert {row["source"] for row in finished.results.rows} == {"sketch", "shy", "archive"}
    assert {row["method"] for row in finished.results.rows} == {"oracle", "guess"}
    (cell,) = finished.failed
    assert "the oracle does not know" in cell.error
    assert len(cell.error) < 2000, "a long error is cut"


def test_a_library_that_is_missing_while_a_sensor_is_prepared_leaves_out_the_source(make_suite, bench_store):
    suite = make_suite(source=["photo"])
    source = prepare_source(suite.source[0], load_objects(suite.objects), suite, bench_store)
    assert not missing(source.used.problem, "'photo'", "camera_driver", "pip install")


def test_recordings_are_found_in_the_data_folder(make_suite, bench_store, tmp_path):
    suite = make_suite(source=[{"name": "archive", "folder": "data:far"}])
    (entry,) = suite.source
    placed = suite.model_copy(update={"data": tmp_path})
    assert prepare_source(entry, {}, placed, bench_store).entry.options == {"folder": str(tmp_path / "far")}
    assert not missing(prepare_source(entry, {}, suite, bench_store).used.problem, "data:far", "`data`")


def test_a_run_in_which_nothing_can_be_used_is_an_error(run_small):
    with pytest.raises(ConfigError, match=naming("'small'", "library-source", "pip install touch-maker")):
        run_small(source=["library-source"])


def test_versions_and_licences_are_recorded(finished):
    sketch, archive = finished.sources[0].used, finished.sources[-1].used
    assert sketch.licence == "public domain"
    assert sketch.libraries.keys() == {"bench-fakes", "numpy"}
    assert sketch.libraries["bench-fakes"] == "1.5"
    assert (archive.recorded, list(archive.objects)) == (True, ["brick"])
    assert finished.methods[1].used.paper == "Anyone, anywhere"


def test_finished_jobs_are_kept(run_small, tmp_path):
    first = run_small(tmp_path)
    again = run_small(tmp_path)
    assert (first.done, again.done) == (2, 0)
    assert again.results.rows == first.results.rows
    more = run_small(tmp_path, method=["guess", {"name": "guess", "label": "slow guess", "sleep_s": 0.001}])
    assert more.done == 1


@pytest.mark.parametrize(
    "changes",
    [
        *({name: value} for name, value in {"seed": 8, "examples": 2, "touches": [1], "press": [0.4, 0.9]}.items()),
        {"source": [{"name": "sketch", "style": "b"}]},
        {"method": [{"name": "guess", "sleep_s": 0.0001}]},
    ],
)
def test_a_change_of_the_inputs_makes_a_new_job(run_small, tmp_path, changes):
    run_small(tmp_path, method=["guess"])
    assert run_small(tmp_path, **{"method": ["guess"], **changes}).done == 1


def test_a_label_does_not_make_a_new_job(run_small, tmp_path):
    run_small(tmp_path, method=["guess"])
    renamed = run_small(tmp_path, method=[{"name": "guess", "label": "nobody"}])
    assert renamed.done == 0
    assert {row["method"] for row in renamed.results.rows} == {"nobody"}


def start_anew() -> None:
    """Forget the imported code, as a new process does."""
    sys.modules.pop("bench_moving", None)
    hash_component.cache_clear()
    registry.cache_clear()


def test_changed_code_of_a_method_makes_a_new_job(run_small, tmp_path):
    import bench_moving

    path = Path(bench_moving.__file__)
    first = run_small(tmp_path, method=["moving", "guess"])
    path.write_text(path.read_text().replace("np.eye(4)[None]", "np.diag([-1.0, -1.0, 1.0, 1.0])[None]"))
    importlib.invalidate_caches()
    start_anew()
    again = run_small(tmp_path, method=["moving", "guess"])
    assert again.done == 1
    one, other = ([row for row in found.results.rows if row["method"] == "moving"] for found in (first, again))
    assert one[0]["T_base_object"] != other[0]["T_base_object"]
    assert run_small(tmp_path, method=["moving", "guess"]).done == 0


@pytest.mark.parametrize("package", ["tactile_loc.locate", "bench_parts"])
def test_changed_code_of_the_source_or_of_tactile_loc_makes_new_jobs(run_small, tmp_path, monkeypatch, package):
    run_small(tmp_path, method=["guess"])
    monkeypatch.setattr(job, "hash_code", lambda name: "changed" if name == package else hash_code(name))
    monkeypatch.setattr(
        "tactile_loc.slots.component.hash_component",
        lambda kind: "changed" if kind.__module__ == package else hash_component(kind),
    )
    assert run_small(tmp_path, method=["guess"]).done == 1


def test_a_worker_with_other_code_does_no_job(make_suite, bench_store, tmp_path):
    class Elsewhere:
        def run_jobs(self, jobs, objects):
            other = {**jobs[0].code, "method": "older"}
            yield do_job(replace(jobs[0], code=other), objects[jobs[0].key])

    found = run_benchmark(make_suite(method=["guess"]), tmp_path, bench_store, Elsewhere())
    assert not missing(found.failed[0].error, "worker", "install the same versions")
    assert found.results.rows == []


def test_a_failed_job_states_its_error_and_is_tried_again(run_small, tmp_path):
    method = [{"name": "guess", "tally": str(tmp_path / "tally")}, "oracle"]
    failed = run_small(tmp_path / "out", method=method)
    (cell,) = failed.failed
    assert not missing(cell.error, "ValueError", "the first call fails")
    assert {row["method"] for row in failed.results.rows} == {"oracle"}
    (trace,) = (tmp_path / "out" / "errors").iterdir()
    assert "Traceback" in trace.read_text()
    row = json.loads((tmp_path / "out" / "rows" / f"{cell.job.key}.json").read_text())
    assert (row["method"], row["object"], row["error"]) == ("guess", "brick", cell.error)
    again = run_small(tmp_path / "out", method=method)
    assert (again.done, again.failed) == (1, [])
    assert list((tmp_path / "out" / "errors").iterdir()) == []


def test_damaged_rows_are_done_again(run_small, tmp_path):
    first = run_small(tmp_path)
    path = sorted((tmp_path / "rows").iterdir())[0]
    path.write_text(path.read_text()[:50])
    again = run_small(tmp_path)
    assert again.done == 1
    assert drop_times(again.results.rows) == drop_times(first.results.rows)


def test_a_run_in_another_folder_and_store_gives_the_same_table(run_small, tmp_path):
    one = run_small(tmp_path / "a", store=tmp_path / "store a", method=["guess"])
    other = run_small(tmp_path / "b", store=tmp_path / "store b", method=["guess"])
    assert drop_times(one.results.rows) == drop_times(other.results.rows)


def test_objects_with_the_same_name_and_a_folder_that_cannot_be_written_are_refused(run_small, box_file, tmp_path):
    copy = tmp_path / box_file.name
    copy.write_text(box_file.read_text())
    with pytest.raises(ConfigError, match=naming("'brick'")):
        run_small(objects=[str(box_file), str(copy)])
    with pytest.raises(ConfigError):
        run_small(copy)
