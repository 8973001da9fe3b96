"""Episodes of data sets: their images and times, written tables, and what is refused."""

import json
import shutil
from pathlib import Path

import datasets
import numpy as np
import pytest
from tactile_loc import TactileLocError

from tactile_loc_datasets.episodes import Episode
from tactile_loc_datasets.readers import read_episode

COLUMN, HZ, ROWS = "observation.images.gel", 10, 6


def read_levels(episode: Episode) -> list[float]:
    return [float(frame.image.mean()) for frame in episode.read_frames()]


@pytest.mark.parametrize("version", ["version_2", "version_3"])
@pytest.mark.parametrize("number", [0, 1])
def test_an_episode_of_lerobot_has_the_images_of_its_rows(request, images, version, number):
    episode = read_episode(request.getfixturevalue(version), number)
    assert read_levels(episode) == pytest.approx(images[number].mean(axis=(1, 2, 3)), abs=4)
    assert episode.table["index"][0] == ROWS * number
    assert (episode.column, len(episode.table)) == (COLUMN, ROWS)
    np.testing.assert_allclose([frame.time_s for frame in episode.read_frames()], np.arange(ROWS) / HZ)


@pytest.mark.parametrize("layout", ["disk", "file", "hub"])
def test_a_hugging_face_data_set_is_read_from_each_layout(hugging_face, images, tmp_path, layout):
    path = tmp_path / ("gel.parquet" if layout == "file" else "gel")
    if layout == "disk":
        hugging_face.save_to_disk(path)
    else:
        file = path if layout == "file" else path / "data" / "train-00000-of-00001.parquet"
        file.parent.mkdir(exist_ok=True, parents=True)
        hugging_face.to_parquet(file)
    assert len(read_episode(path).table) == 2 * ROWS
    second = read_episode(path, 1)
    np.testing.assert_array_equal([frame.image for frame in second.read_frames()], images[1])


def test_depths_are_read_as_depths(tmp_path):
    features = datasets.Features({"depth": datasets.Array2D((3, 4), "float32")})
    depths = np.arange(24, dtype=np.float32).reshape(2, 3, 4) / 8
    datasets.Dataset.from_dict({"depth": list(depths)}, features).to_parquet(tmp_path / "depth.parquet")
    frames = list(read_episode(tmp_path / "depth.parquet", column="depth").read_frames())
    np.testing.assert_array_equal([frame.image for frame in frames], depths)


def test_columns_are_added_and_images_stay_images(hugging_face, tmp_path):
    hugging_face.to_parquet(tmp_path / "gel.parquet")
    columns = {"object_pose": [[0.5] * 7, *[None] * (2 * ROWS - 1)], "object_verdict": ["certain"] * 2 * ROWS}
    read_episode(tmp_path / "gel.parquet").write(tmp_path / "out.parquet", columns)
    written = datasets.Dataset.from_parquet(str(tmp_path / "out.parquet"), cache_dir=str(tmp_path / "cache"))
    assert written.column_names == [*hugging_face.column_names, *columns]
    assert (written[0]["object_pose"], written[1]["object_pose"]) == ([0.5] * 7, None)
    assert written[3]["gel"].size == (128, 96)


def test_a_damaged_image_is_a_frame_with_a_problem(tmp_path):
    rows = {"gel": [{"bytes": b"no image", "path": None}]}
    datasets.Dataset.from_dict(rows, datasets.Features({"gel": datasets.Image()})).to_parquet(tmp_path / "gel.parquet")
    (frame,) = read_episode(tmp_path / "gel.parquet").read_frames()
    assert isinstance(frame.problem, TactileLocError)


def test_a_video_that_ends_early_is_refused(version_2):
    film = next(version_2.glob("videos/**/episode_000000.mp4"))
    info = version_2 / "meta" / "info.json"
    shutil.copy(next(version_2.glob("data/**/episode_000000.parquet")), version_2 / "kept.parquet")
    film.write_bytes(film.read_bytes()[:200])
    with pytest.raises(TactileLocError, match=film.name):
        list(read_episode(version_2).read_frames())
    info.write_text(json.dumps(json.loads(info.read_text()) | {"data_path": "lost.parquet"}))
    with pytest.raises(TactileLocError, match=r"lost\.parquet"):
        read_episode(version_2)


def test_missing_episodes_and_columns_are_refused(version_3, hugging_face, tmp_path):
    with pytest.raises(TactileLocError, match="no episode 2; it has 2"):
        read_episode(version_3, 2)
    with pytest.raises(TactileLocError, match=COLUMN):
        read_episode(version_3, column="observation.images.gell")
    hugging_face.remove_columns("gel").to_parquet(tmp_path / "plain.parquet")
    with pytest.raises(TactileLocError, match="--column: timestamp"):
        read_episode(tmp_path / "plain.parquet")
    hugging_face.remove_columns("episode_index").to_parquet(tmp_path / "plain.parquet")
    with pytest.raises(TactileLocError, match="episode_index"):
        read_episode(tmp_path / "plain.parquet", 1)
    for path in (tmp_path / "nothing", Path(__file__).parent):
        with pytest.raises(TactileLocError, match=path.name):
            read_episode(path)


@pytest.mark.parametrize("kind", ["video", "image"])
def test_a_data_set_that_lerobot_wrote_is_read(images, tmp_path, kind):
    library = pytest.importorskip("lerobot.datasets.lerobot_dataset", reason="lerobot is not installed")
    features = {COLUMN: {"dtype": kind, "shape": (96, 128, 3), "names": ["height", "width", "channels"]}}
    made = library.LeRobotDataset.create("me/gel", HZ, features, tmp_path / "gel", use_videos=kind == "video")
    for number in range(2):
        for image in images[number]:
            made.add_frame({COLUMN: image, "task": "touch"})
        made.save_episode()
    made.finalize()
    expected = images[1].mean(axis=(1, 2, 3))
    assert read_levels(read_episode(tmp_path / "gel", 1)) == pytest.approx(expected, abs=4)
